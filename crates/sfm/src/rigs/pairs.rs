//! Image pairs of one instant from two cameras of a rig, and their relative poses.
//!
//! Images are paired by time, each on its camera's own clock, so the clocks must agree to within
//! half the interval between images. An image without a time is in no pair. Unless most images of
//! each camera have times, images are paired by their names.

use tiepoint_rig::{RelativePose, interval_s};
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use super::succession::rig_candidates_apart;
use crate::frame_names::pairs_by_name;
use crate::timeline::{images_in_coarse_time, images_in_time};

/// Two images of one instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RigPair {
    /// Image of the reference camera.
    pub reference: ImageId,
    /// Image of another camera.
    pub other: ImageId,
}

/// The image pairs of two cameras.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RigPairs {
    /// The reference camera.
    pub reference: CameraId,
    /// The other camera.
    pub other: CameraId,
    /// The pairs, in order of time.
    pub pairs: Vec<RigPair>,
}

/// Pairs the images of every camera that may be on a rig with those of the reference camera, which
/// is the first one. Cameras without a pair are left out.
pub fn rig_pairs(scene: &Reconstruction) -> Vec<RigPairs> {
    let images = rig_candidates_apart(scene);
    let mut cameras = images.iter();
    let Some((&reference, reference_images)) = cameras.next() else { return Vec::new() };
    cameras
        .map(|(&other, other_images)| {
            let pairs = match (
                images_in_time(scene, reference_images),
                images_in_time(scene, other_images),
            ) {
                (Some(references), Some(others)) => by_time(&references, &others),
                _ => by_name(scene, reference_images, other_images),
            };
            RigPairs { reference, other, pairs }
        })
        .filter(|rig| !rig.pairs.is_empty())
        .collect()
}

/// The median interval between images, in seconds.
fn interval(images: &[(f64, ImageId)]) -> f64 {
    interval_s(&images.iter().map(|(time_s, _)| *time_s).collect::<Vec<f64>>())
}

/// Returns the pairs of mutually nearest images in time, closer than half the median interval.
pub(crate) fn by_time(references: &[(f64, ImageId)], others: &[(f64, ImageId)]) -> Vec<RigPair> {
    let max_difference_s = 0.5 * interval(references).max(interval(others));
    let nearest = |time_s: f64, images: &[(f64, ImageId)]| -> usize {
        let after = images.partition_point(|image| image.0 < time_s);
        let distance = |index: usize| {
            images.get(index).map_or(f64::INFINITY, |image| (image.0 - time_s).abs())
        };
        if after > 0 && distance(after - 1) <= distance(after) { after - 1 } else { after }
    };
    let mut pairs = Vec::new();
    for (index, &(time_s, reference)) in references.iter().enumerate() {
        let Some(&(other_s, other)) = others.get(nearest(time_s, others)) else { continue };
        if nearest(other_s, references) == index && (other_s - time_s).abs() <= max_difference_s {
            pairs.push(RigPair { reference, other });
        }
    }
    pairs
}

/// Shortest interval between the images of a camera whose times in whole seconds tell frames, in
/// seconds: those of one instant differ by one at most.
const MIN_COARSE_INTERVAL_S: f64 = 3.0;

/// Returns the pairs of images of one instant by their names, or, if these tell none, by times that
/// were rounded to seconds where the images are far enough apart.
pub(crate) fn by_name(
    scene: &Reconstruction,
    references: &[ImageId],
    others: &[ImageId],
) -> Vec<RigPair> {
    let names = |ids: &[ImageId]| -> Vec<&str> {
        ids.iter().map(|&id| scene.image(id).name.as_str()).collect()
    };
    let pairs = pairs_by_name(&names(references), &names(others)).into_iter();
    let pair = |(a, b): (usize, usize)| RigPair { reference: references[a], other: others[b] };
    let pairs: Vec<RigPair> = pairs.map(pair).collect();
    let coarse = |ids: &[ImageId]| {
        images_in_coarse_time(scene, ids).filter(|times| interval(times) >= MIN_COARSE_INTERVAL_S)
    };
    match (coarse(references), coarse(others)) {
        (Some(references), Some(others)) if pairs.is_empty() => by_time(&references, &others),
        _ => pairs,
    }
}

/// Returns the relative poses of the pairs with two registered images, in order of time.
pub fn relative_poses(model: &Reconstruction, pairs: &[RigPair]) -> Vec<(RigPair, RelativePose)> {
    let pose = |image| model.image(image).cam_from_world();
    pairs
        .iter()
        .filter_map(|pair| {
            Some((*pair, RelativePose::between(pose(pair.reference)?, pose(pair.other)?)))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_geometry::{CameraModelKind, Intrinsics};
    use tiepoint_scene::{Camera, Image};

    /// Two cameras with images at the given times; the ids of the second one's images follow
    /// those of the first one's.
    fn scene(references: &[Option<f64>], others: &[Option<f64>]) -> Reconstruction {
        let mut scene = Reconstruction::default();
        for (folder, times) in [("left", references), ("right", others)] {
            let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
            let camera = scene.add_camera(Camera {
                intrinsics,
                width: 640,
                height: 480,
                has_focal_prior: true,
            });
            for (index, &time_s) in times.iter().enumerate() {
                let image = scene.add_image(Image::new(
                    format!("{folder}/{index:06}.png"),
                    camera,
                    Vec::new(),
                ));
                scene.set_time(image, time_s);
            }
        }
        scene
    }

    fn pairs(scene: &Reconstruction) -> Vec<(u32, u32)> {
        let rigs = rig_pairs(scene);
        rigs.iter()
            .flat_map(|rig| &rig.pairs)
            .map(|pair| (pair.reference.0, pair.other.0))
            .collect()
    }

    #[test]
    fn images_of_one_instant_are_mutually_nearest() {
        // The other clock is 0.04 s ahead, its second image is missing, and it records longer.
        let references = [0.0, 0.1, 0.2, 0.3].map(Some);
        let others = [0.04, 0.24, 0.34, 0.44].map(Some);
        assert_eq!(pairs(&scene(&references, &others)), [(0, 4), (2, 5), (3, 6)]);
    }

    #[test]
    fn at_different_rates_some_images_are_unpaired() {
        let references = [0.0, 0.1, 0.2, 0.3].map(Some);
        let others = [0.01, 0.21].map(Some);
        assert_eq!(pairs(&scene(&references, &others)), [(0, 4), (2, 5)]);
        assert!(
            pairs(&scene(&references, &[Some(10.0), Some(10.1)])).is_empty(),
            "these clocks do not agree at all"
        );
    }

    #[test]
    fn an_image_without_a_time_costs_the_others_no_frame() {
        let references = [0.0, 0.1, 0.2].map(Some);
        assert_eq!(pairs(&scene(&references, &[Some(0.1), None, Some(0.2)])), [(1, 3), (2, 5)]);
        // Most have lost theirs: names are left.
        let others = [Some(0.1), None, None];
        assert_eq!(pairs(&scene(&references, &others)), [(0, 3), (1, 4), (2, 5)]);
    }

    /// EXIF has whole seconds. The second clock is 0.7 s ahead.
    #[test]
    fn times_in_whole_seconds_are_not_exact() {
        let rounded = |begin_s: f64, intervals_s: &[f64]| -> Vec<Option<f64>> {
            let mut time_s = begin_s;
            let mut times = vec![Some(time_s.floor())];
            times.extend(intervals_s.iter().map(|interval_s| {
                time_s += interval_s;
                Some(time_s.floor())
            }));
            times
        };
        // Two images a second, and one about every three seconds: numbers in names tell.
        for intervals_s in [&[0.5; 5], &[2.7, 3.4, 2.6, 3.3, 3.1]] {
            let scene = scene(&rounded(0.0, intervals_s), &rounded(0.7, intervals_s));
            assert_eq!(pairs(&scene), [(0, 6), (1, 7), (2, 8), (3, 9), (4, 10), (5, 11)]);
        }
        // Other names: times tell only where images are far enough apart.
        for (interval_s, expected) in [(0.5, 0), (3.3, 6)] {
            let times = [0.0, 0.7].map(|begin_s| rounded(begin_s, &[interval_s; 5]));
            let mut scene = scene(&times[0], &times[1]);
            let ids: Vec<ImageId> = scene.images().map(|(id, _)| id).collect();
            let mut renamed = Reconstruction::default();
            let camera = *scene.camera(CameraId(0));
            let cameras = [0, 1].map(|_| renamed.add_camera(camera));
            for (index, id) in ids.into_iter().enumerate() {
                let camera = cameras[index / 6];
                let name = format!("{}/{}.png", index / 6, 100 + index * index);
                let image = renamed.add_image(Image::new(name, camera, Vec::new()));
                let time_s = scene.image(id).time_s;
                renamed.set_time(image, time_s);
            }
            scene = renamed;
            assert_eq!(pairs(&scene).len(), expected, "{interval_s} s");
        }
        // An interval timer of whole seconds is exact.
        let seconds: Vec<Option<f64>> = (0..6).map(|k| Some(f64::from(k))).collect();
        let late: Vec<Option<f64>> = (2..8).map(|k| Some(f64::from(k))).collect();
        assert_eq!(pairs(&scene(&seconds, &late)), [(2, 6), (3, 7), (4, 8), (5, 9)]);
    }

    #[test]
    fn without_times_images_are_paired_by_file_name() {
        assert_eq!(pairs(&scene(&[None; 3], &[None, Some(0.0)])), [(0, 3), (1, 4)]);
        assert!(rig_pairs(&scene(&[None; 3], &[])).is_empty(), "a lone camera");
    }
}
