//! The visit of all images.

use rayon::prelude::*;

use super::cache::Cache;
use super::image::{Agreement, FusionImage, agreement, mark};
use super::options::FusionOptions;

/// Most neighbours of an image: the supporting images of a point are the bits of a word.
pub const MAX_NEIGHBOURS: usize = 31;

/// A point of the fused cloud.
#[derive(Clone, Debug, PartialEq)]
pub struct FusedPoint {
    /// Position in the world frame.
    pub xyz: [f32; 3],
    /// Unit normal in the world frame, towards the cameras.
    pub normal: [f32; 3],
    /// Red, green, blue.
    pub color: [u8; 3],
    /// Probability that the point is within five footprints of the surface.
    pub confidence: f32,
    /// Indices of the images that see the point, sorted.
    pub views: Vec<u32>,
}

/// Fuses depth maps. `neighbours` has, for each image, the images that may see the same surfaces.
/// `load` reads an image, and may be called more than once for the same one; `take` gets the points
/// in a fixed order.
///
/// Images are visited in order. A pixel gives a point if enough images agree with it, at the mean
/// of their depths along its ray, unless one of these images has more pixels on the surface: an
/// earlier one whose surface is in the cloud, or a later one, to which the surface is left.
///
/// # Errors
/// Those of `load` and `take`.
pub fn fuse<E>(
    neighbours: &[Vec<usize>],
    options: &FusionOptions,
    mut load: impl FnMut(usize) -> Result<FusionImage, E>,
    mut take: impl FnMut(FusedPoint) -> Result<(), E>,
) -> Result<(), E> {
    let last_use = last_uses(neighbours);
    let mut cache = Cache::new(options.max_images_in_memory.max(2));
    for (index, others) in neighbours.iter().enumerate() {
        let others = &others[..others.len().min(MAX_NEIGHBOURS)];
        cache.require(index, others, &mut load)?;
        let reference = cache.get(index);
        let loaded: Vec<(usize, &FusionImage)> =
            others.iter().filter_map(|other| Some((*other, cache.find(*other)?))).collect();
        let width = reference.camera.width.max(1);
        let rows: Vec<Row> = (0..reference.camera.height)
            .into_par_iter()
            .map(|y| fuse_row(index, reference, &loaded, y, options))
            .collect();
        let mut marks = vec![0; reference.depths.len().div_ceil(64)];
        let slots: Vec<usize> = loaded.iter().map(|(other, _)| *other).collect();
        for (y, row) in rows.iter().enumerate() {
            row.in_cloud.iter().for_each(|x| mark(&mut marks, y * width + *x as usize));
        }
        cache.set_marks(index, marks);
        for row in rows {
            for (slot, pixel) in row.left {
                cache.mark(slots[slot as usize], pixel as usize);
            }
            for point in row.points {
                take(named(point, index, &slots))?;
            }
        }
        cache.forget_unused(index, &last_use);
    }
    Ok(())
}

/// For each image, the last image whose visit needs it.
fn last_uses(neighbours: &[Vec<usize>]) -> Vec<usize> {
    let mut last: Vec<usize> = (0..neighbours.len()).collect();
    for (index, others) in neighbours.iter().enumerate() {
        for other in others.iter().filter(|other| **other < neighbours.len()) {
            last[*other] = last[*other].max(index);
        }
    }
    last
}

/// Odds of a point whose depths are as often right as wrong: they agree.
const AGREED_ODDS: f64 = 8.5;
/// Exponent of the product of the odds of depths, which tell in part the same. It and the odds are
/// fitted on scenes that no table has (`docs/benchmarks/dense.md`).
const SHARED: f64 = 0.19;

/// The probability that a point is right, from the product of the odds of its depths, which single
/// precision does not hold: of 32 depths it is up to 254³².
fn confidence(odds: f64) -> f32 {
    let odds = AGREED_ODDS * odds.powf(SHARED);
    (odds / (1.0 + odds)) as f32
}

/// The pixels of a row whose surface is in the cloud, or will be.
#[derive(Default)]
struct Row {
    points: Vec<PointCandidate>,
    /// Columns of the points, and of pixels whose surface an earlier image gave.
    in_cloud: Vec<u32>,
    /// Pixels of later images that shall give a surface, by the place of the image among the
    /// neighbours.
    left: Vec<(u32, u32)>,
}

/// What becomes of the surface of a pixel.
enum Outcome {
    /// A new point.
    Point(PointCandidate),
    /// An earlier image gave it.
    InCloud,
    /// A later image with more pixels on it shall give it.
    Left { slot: u32, pixel: u32 },
}

/// A point whose images are bits: the reference first, then its neighbours.
struct PointCandidate {
    xyz: [f32; 3],
    normal: [f32; 3],
    color: [u8; 3],
    confidence: f32,
    views: u32,
}

fn named(draft: PointCandidate, index: usize, others: &[usize]) -> FusedPoint {
    let PointCandidate { xyz, normal, color, confidence, views } = draft;
    let all = std::iter::once(&index).chain(others).enumerate();
    let seen = all.filter(|(bit, _)| views & 1 << bit != 0);
    let mut views: Vec<u32> = seen.map(|(_, image)| *image as u32).collect();
    views.sort_unstable();
    FusedPoint { xyz, normal, color, confidence, views }
}

fn fuse_row(
    index: usize,
    reference: &FusionImage,
    others: &[(usize, &FusionImage)],
    y: usize,
    options: &FusionOptions,
) -> Row {
    let mut row = Row::default();
    for x in 0..reference.camera.width {
        match fuse_pixel(index, reference, others, x, y, options) {
            None => {}
            Some(Outcome::InCloud) => row.in_cloud.push(x as u32),
            Some(Outcome::Left { slot, pixel }) => row.left.push((slot, pixel)),
            Some(Outcome::Point(point)) => {
                row.in_cloud.push(x as u32);
                row.points.push(point);
            }
        }
    }
    row
}

fn fuse_pixel(
    index: usize,
    reference: &FusionImage,
    others: &[(usize, &FusionImage)],
    x: usize,
    y: usize,
    options: &FusionOptions,
) -> Option<Outcome> {
    let own = reference.surface(x, y)?;
    let mut views = 1u32;
    let (mut depth, mut normal) = (own.depth, own.normal);
    let mut color = own.color.map(u32::from);
    let mut odds = f64::from(own.odds);
    let point = own.world_point(own.depth);
    let min_cosine = options.max_normal_error_rad.cos();
    let mut finest = (1.0, None);
    // Images in whose frame the point lies.
    let mut frames = 1;
    for (slot, (other_index, other)) in others.iter().enumerate() {
        let Some((in_other, pixel)) = other.seen(&point) else { continue };
        frames += 1;
        let agreed = agreement(reference, &own, other, &in_other, pixel, min_cosine, options);
        let Some(Agreement { depth: other_depth, surface, area }) = agreed else { continue };
        let is_earlier = *other_index < index;
        if is_earlier && area <= 1.0 && other.is_marked(surface.index) {
            return Some(Outcome::InCloud);
        }
        if !is_earlier && area < finest.0 {
            finest = (area, Some((slot as u32, surface.index as u32)));
        }
        views |= 2 << slot;
        depth += other_depth;
        normal += surface.normal;
        odds *= f64::from(surface.odds);
        (0..3).for_each(|channel| color[channel] += u32::from(surface.color[channel]));
    }
    let count = views.count_ones();
    // A second one confirms a surface that lies in no third image.
    let possible = frames.max(2).min(others.len() + 1);
    let is_enough = count as usize >= options.min_views.min(possible);
    // An earlier image that left its surface to this one has found enough images.
    let was_enough = count > 1 && reference.is_marked(own.index);
    if !(is_enough || was_enough) {
        return None;
    }
    if let (_, Some((slot, pixel))) = finest {
        return Some(Outcome::Left { slot, pixel });
    }
    let xyz = own.world_point(depth / f64::from(count));
    let length = normal.norm();
    let normal = if length > 0.0 { normal / length } else { own.normal };
    let point = PointCandidate {
        xyz: [xyz.x as f32, xyz.y as f32, xyz.z as f32],
        normal: [normal.x as f32, normal.y as f32, normal.z as f32],
        color: color.map(|sum| ((sum + count / 2) / count) as u8),
        confidence: confidence(odds),
        views,
    };
    Some(Outcome::Point(point))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_many_sure_depths_are_sure() {
        // The odds of the surest and of the most doubtful depth are 254 and 1 / 254.
        assert_eq!(confidence(254f64.powi(32)), 1.0);
        let doubtful = confidence(254f64.powi(-32));
        assert!(0.0 < doubtful && doubtful < 1e-10, "{doubtful}");
        assert!((confidence(1.0) - 8.5 / 9.5).abs() < 1e-6);
    }
}
