//! The visit of all images.

use rayon::prelude::*;

use super::cache::Cache;
use super::image::{Agreement, FusionImage, agreement};
use super::options::FusionOptions;

/// Most neighbours of an image: the supporting images of a point are the bits of a word.
pub const MAX_NEIGHBOURS: usize = 31;

/// A pixel gives no point if an earlier image has a point on its surface, and the pixel of that
/// point covers at most this many times the area that this pixel covers. With 2, images at all
/// distances give together at most twice the points of the nearest image: each coarser image that
/// gives points has at most half as many pixels on the surface as the next finer one (1 + 1/2 +
/// 1/4 + …). With 1, images at nearly equal distances all give points (`docs/benchmarks/dense.md`).
const MAX_COVERED_AREA: f64 = 2.0;

/// A point of the fused cloud.
#[derive(Clone, Debug, PartialEq)]
pub struct FusedPoint {
    /// Position in the world frame.
    pub xyz: [f32; 3],
    /// Unit normal in the world frame, towards the cameras.
    pub normal: [f32; 3],
    /// Red, green, blue.
    pub color: [u8; 3],
    /// Indices of the images that see the point, sorted.
    pub views: Vec<u32>,
}

/// Fuses depth maps. `neighbours` has, for each image, the images that may see the same surfaces.
/// `load` reads an image, and may be called more than once for the same one; `take` gets the points
/// in a fixed order.
///
/// Images are visited in order. A pixel gives a point if enough images agree with it, at the mean
/// of their depths along its ray, unless an earlier image that has at least half as many pixels on
/// the surface has given one there.
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
        let width = reference.depths.width.max(1);
        let rows: Vec<Vec<Pixel>> = (0..reference.depths.height)
            .into_par_iter()
            .map(|y| {
                let pixel = |x| fuse_pixel(index, reference, &loaded, x, y, options);
                (0..width).filter_map(pixel).collect()
            })
            .collect();
        let mut is_covered = vec![false; reference.depths.depths.len()];
        let slots: Vec<usize> = loaded.iter().map(|(other, _)| *other).collect();
        for (y, row) in rows.into_iter().enumerate() {
            for pixel in row {
                is_covered[y * width + pixel.x as usize] = true;
                if let Some(point) = pixel.point {
                    take(named(*point, index, &slots))?;
                }
            }
        }
        cache.set_covered(index, is_covered);
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

/// A pixel whose surface is in the cloud: with a new point, or without if an earlier image gave it.
struct Pixel {
    x: u32,
    point: Option<Box<PointCandidate>>,
}

/// A point whose images are bits: the reference first, then its neighbours.
struct PointCandidate {
    xyz: [f32; 3],
    normal: [f32; 3],
    color: [u8; 3],
    views: u32,
}

fn named(draft: PointCandidate, index: usize, others: &[usize]) -> FusedPoint {
    let PointCandidate { xyz, normal, color, views } = draft;
    let all = std::iter::once(&index).chain(others).enumerate();
    let seen = all.filter(|(bit, _)| views & 1 << bit != 0);
    let mut views: Vec<u32> = seen.map(|(_, image)| *image as u32).collect();
    views.sort_unstable();
    FusedPoint { xyz, normal, color, views }
}

fn fuse_pixel(
    index: usize,
    reference: &FusionImage,
    others: &[(usize, &FusionImage)],
    x: usize,
    y: usize,
    options: &FusionOptions,
) -> Option<Pixel> {
    let own = reference.surface(x, y)?;
    let mut views = 1u32;
    let (mut depth, mut normal) = (own.depth, own.normal);
    let mut color = own.color.map(u32::from);
    let point = reference.world_point(&own, own.depth);
    let min_cosine = options.max_normal_error_rad.cos();
    for (slot, (other_index, other)) in others.iter().enumerate() {
        let Some(Agreement { depth: other_depth, surface, is_covered, area }) =
            agreement(reference, &own, &point, other, min_cosine, options)
        else {
            continue;
        };
        if *other_index < index && is_covered && area <= MAX_COVERED_AREA * own.area {
            return Some(Pixel { x: x as u32, point: None });
        }
        views |= 2 << slot;
        depth += other_depth;
        normal += surface.normal;
        (0..3).for_each(|channel| color[channel] += u32::from(surface.color[channel]));
    }
    let count = views.count_ones();
    if (count as usize) < options.min_views.min(others.len() + 1) {
        return None;
    }
    let xyz = reference.world_point(&own, depth / f64::from(count));
    let length = normal.norm();
    let normal = if length > 0.0 { normal / length } else { own.normal };
    let point = PointCandidate {
        xyz: [xyz.x as f32, xyz.y as f32, xyz.z as f32],
        normal: [normal.x as f32, normal.y as f32, normal.z as f32],
        color: color.map(|sum| ((sum + count / 2) / count) as u8),
        views,
    };
    Some(Pixel { x: x as u32, point: Some(Box::new(point)) })
}
