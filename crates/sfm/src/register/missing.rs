//! Missing correspondences: images that do not see what images on both sides of them see.
//!
//! With repeated structure an image can have many inliers at a wrong pose: it sees the copy. What
//! it does not see is the rest of the place (Zach, Klopschitz & Pollefeys 2010; Wilson & Snavely
//! 2013). A point that two images observe from both sides of a third one, whose image it falls
//! into, is hardly hidden from it, and it looks neither larger nor smaller there nor much turned.
//! Single points are missed often, and parts of an image rarely: the image is divided into cells,
//! and a cell in which the image has keypoints counts as empty if it observes none of the points.
//! An image is contradicted if most of its cells are empty, and more than chance explains beside
//! the other images of the model: where the model itself is folded, right images have many empty
//! cells, too.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{CorrespondenceGraph, ImageId, Observation, Reconstruction, Track};

use super::recall::{MAX_DISTANCE_RATIO, visible_to_neighbours};
use super::significance::{are_too_few, ln_binomial_false_alarms};
use super::square_cells::square_cell;

/// Points of a cell that tells something, and cells of such an image. These two and the third
/// quartile below were chosen on the rendered table and facade of docs/benchmarks/photos.md,
/// without half and double.
const MIN_POINTS: usize = 3;
const MIN_CELLS: usize = 5;
/// Share of empty cells of a right image at least: three points, each missed with 0.4, as usual
/// (`recall`: right images see 0.49 to 0.76).
const MIN_SHARE: f64 = 0.06;
/// Largest angle between two views of a point. Half of the points of a textured plane are found at
/// it (Mikolajczyk & Schmid 2005).
const MAX_VIEW_ANGLE_COS: f64 = 0.866;
/// Seen from an image, two views are on both sides if they are at least 120° apart. The views then
/// are at most 1 / sin 60° = 1.15 times as far from each other by way of the image.
const BOTH_SIDES_COS: f64 = -0.5;
/// At most this many views of a point are compared with each other, evenly among all.
const MAX_VIEWS: usize = 16;

/// Cells in which others see points, and those of them in which an image sees none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Cells {
    num: usize,
    num_empty: usize,
}

/// The image that is contradicted most by the points that others observe; `None` if none is.
pub(crate) fn contradicted(graph: &CorrespondenceGraph, model: &Reconstruction) -> Option<ImageId> {
    let images: Vec<(ImageId, Rigid3)> =
        model.registered().map(|(id, _, pose)| (id, *pose)).collect();
    let cells: Vec<(ImageId, Cells)> = images
        .par_iter()
        .map(|(image, pose)| (*image, cells(graph, model, *image, pose)))
        .filter(|(_, cells)| cells.num >= MIN_CELLS)
        .collect();
    most_contradicted(&cells)
}

/// The image whose empty cells chance explains least, if it does not explain them.
fn most_contradicted(cells: &[(ImageId, Cells)]) -> Option<ImageId> {
    let mut shares: Vec<f64> =
        cells.iter().map(|(_, cells)| cells.num_empty as f64 / cells.num as f64).collect();
    shares.sort_by(f64::total_cmp);
    // The third quartile: most images are right, and some places are seen worse than others.
    let usual = shares.get(3 * shares.len() / 4)?.max(MIN_SHARE);
    let false_alarms =
        |found: &Cells| ln_binomial_false_alarms(cells.len(), found.num, found.num_empty, usual);
    let mostly_empty = cells.iter().filter(|(_, found)| 2 * found.num_empty > found.num);
    let tested = mostly_empty.map(|(image, found)| (false_alarms(found), *image));
    let (worst, image) = tested.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))?;
    are_too_few(worst).then_some(image)
}

fn cells(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    image: ImageId,
    cam_from_world: &Rigid3,
) -> Cells {
    let camera = model.camera_of(image);
    let mut points: BTreeMap<(i64, i64), (usize, usize)> = BTreeMap::new();
    for point in visible_to_neighbours(graph, model, image) {
        let Some(track) = model.track(point) else { continue };
        let pixel = camera.intrinsics.project(&(*cam_from_world * track.xyz));
        let Some(pixel) = pixel.filter(|pixel| camera.contains(pixel)) else { continue };
        if is_seen_from_both_sides(model, track, image, cam_from_world) {
            let (num, found) = points.entry(square_cell(camera, &pixel)).or_insert((0, 0));
            *num += 1;
            *found += usize::from(track.observations.iter().any(|o| o.image == image));
        }
    }
    // Nothing can be found behind a mask, or where all is blurred.
    let keypoints = model.image(image).keypoints.iter();
    let occupied: BTreeSet<(i64, i64)> =
        keypoints.map(|it| square_cell(camera, &it.pixel)).collect();
    let informative =
        points.iter().filter(|(cell, (num, _))| *num >= MIN_POINTS && occupied.contains(cell));
    informative.fold(Cells::default(), |sum, (_, (_, found))| Cells {
        num: sum.num + 1,
        num_empty: sum.num_empty + usize::from(*found == 0),
    })
}

/// Whether two other images observe a point from both sides of an image, and it has a size between
/// the sizes that it has there.
fn is_seen_from_both_sides(
    model: &Reconstruction,
    track: &Track,
    image: ImageId,
    cam_from_world: &Rigid3,
) -> bool {
    let view = |image: ImageId, pose: &Rigid3| {
        let ray = pose.origin_in_a() - track.xyz;
        let size = model.camera_of(image).intrinsics.mean_focal_px() / ray.norm();
        (ray.normalize(), size)
    };
    let (direction, size) = view(image, cam_from_world);
    // The directions of the other views, as seen from this one, and the sizes of the point.
    let aside = |observation: &Observation| -> Option<(Vector3<f64>, f64)> {
        let pose = model.image(observation.image).cam_from_world()?;
        let (other, size) = view(observation.image, pose);
        let along = other.dot(&direction);
        let aside = (other - direction * along).try_normalize(f64::EPSILON)?;
        (observation.image != image && along > MAX_VIEW_ANGLE_COS).then_some((aside, size))
    };
    let step = track.observations.len().div_ceil(MAX_VIEWS);
    let views: Vec<_> = track.observations.iter().step_by(step).filter_map(aside).collect();
    views.iter().enumerate().any(|(k, (one, one_size))| {
        views[..k].iter().any(|(other, other_size)| {
            let (low, high) = (one_size.min(*other_size), one_size.max(*other_size));
            let sizes = low / MAX_DISTANCE_RATIO..=high * MAX_DISTANCE_RATIO;
            one.dot(other) < BOTH_SIDES_COS && sizes.contains(&size)
        })
    })
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::nalgebra::Vector2;
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rng};
    use tiepoint_scene::{Camera, Image, ImagePair, Keypoint, Match, TwoView, TwoViewKind};

    use super::*;

    const IMAGES: usize = 12;
    const POINTS: usize = 800;
    const COLUMNS: usize = 32;
    /// How often a right image finds a point: the lower end of what right images see (`recall`).
    const FOUND: f64 = 0.5;
    const DRAWS: u64 = 20;

    /// Images that pass a wall of points a metre apart. Each finds some of the points; `wrong` only
    /// those right of `from_px`. It has keypoints right of `masked_px`, the others everywhere.
    fn contradicted_of(seed: u64, wrong: usize, from_px: f64, masked_px: f64) -> Option<ImageId> {
        let mut rng = Rng::stream(seed, &[]);
        let intrinsics = Intrinsics::centred(CameraModelKind::SimpleRadial, 500.0, 640, 480);
        let mut model = Reconstruction::default();
        let camera =
            model.add_camera(Camera { intrinsics, width: 640, height: 480, has_focal_prior: true });
        // Only their places over the image matter.
        let keypoints = |k: usize| -> Vec<Keypoint> {
            let from_px = if k == wrong { masked_px } else { 0.0 };
            let place = |at: usize| {
                let (column, row) = ((at % COLUMNS) as f64, (at / COLUMNS) as f64);
                let x = from_px + column * (640.0 - from_px) / COLUMNS as f64;
                Vector2::new(x, row * 480.0 / (POINTS / COLUMNS) as f64)
            };
            (0..POINTS).map(|at| Keypoint { pixel: place(at), scale_px: 1.0 }).collect()
        };
        let images: Vec<ImageId> = (0..IMAGES)
            .map(|k| {
                let image = Image::new(format!("{k}"), camera, keypoints(k));
                let image = model.add_image(image);
                let centre = Vector3::new(k as f64, 0.2 * rng.normal(), 0.0);
                model.register(image, Rigid3::from_axis_angle(Vector3::zeros(), -centre));
                image
            })
            .collect();
        for keypoint in 0..POINTS as u32 {
            let [along, up, depth] = [0; 3].map(|_| rng.uniform());
            let xyz = Vector3::new(22.0 * along - 5.0, 9.0 * up - 4.5, 10.0 + depth);
            let finds = |image: &ImageId| {
                let pose = model.image(*image).cam_from_world()?;
                let pixel = intrinsics.project(&(*pose * xyz))?;
                let is_open = image.index() != wrong || pixel.x >= from_px;
                let inside = model.camera(camera).contains(&pixel);
                (inside && is_open && rng.uniform() < FOUND)
                    .then_some(Observation { image: *image, keypoint })
            };
            let observations: Vec<Observation> = images.iter().filter_map(finds).collect();
            if observations.len() >= 2 {
                model.add_track(Track::new(xyz, observations));
            }
        }
        let pairs = images.windows(2).chain(images.windows(3)).map(|some| {
            let pair = ImagePair::new(some[0], some[some.len() - 1]).expect("two images");
            let matches = vec![Match { a: 0, b: 0 }];
            (pair, TwoView { kind: TwoViewKind::Calibrated, matches, ..TwoView::default() })
        });
        let graph = CorrespondenceGraph::new(&[POINTS; IMAGES], pairs);
        contradicted(&graph, &model)
    }

    /// The images at the ends have others on one side only, which tells nothing.
    #[test]
    fn an_image_that_sees_a_copy_is_contradicted() {
        for seed in 0..DRAWS {
            let from_px = 0.65 * 640.0;
            assert_eq!(contradicted_of(seed, 5, 0.0, 0.0), None, "{seed}");
            let found = contradicted_of(seed, 5, from_px, 0.0);
            assert_eq!(found.map(|image| image.index()), Some(5), "{seed}");
            assert_eq!(contradicted_of(seed, 0, from_px, 0.0), None, "{seed}");
            assert_eq!(contradicted_of(seed, 5, from_px, from_px), None, "a mask, {seed}");
        }
    }

    #[test]
    fn most_cells_and_more_than_usual_must_be_empty() {
        let image = |k: u32| ImageId(k);
        let with = |num_empty: usize| {
            let right = (1..20).map(|k| (image(k), Cells { num: 30, num_empty: 1 }));
            let tested = [(image(0), Cells { num: 30, num_empty })];
            most_contradicted(&tested.into_iter().chain(right).collect::<Vec<_>>())
        };
        assert_eq!(with(15), None);
        assert_eq!(with(16), Some(image(0)));
        // Few cells may be empty by chance.
        let few = [
            (image(0), Cells { num: 5, num_empty: 3 }),
            (image(1), Cells { num: 5, num_empty: 2 }),
        ];
        assert_eq!(most_contradicted(&few), None);
        // Where a quarter of the images has as many empty cells, the scene explains them.
        let common =
            (0..20).map(|k| (image(k), Cells { num: 30, num_empty: 16 * (k as usize % 2) }));
        assert_eq!(most_contradicted(&common.collect::<Vec<_>>()), None);
        assert_eq!(most_contradicted(&[]), None);
    }
}
