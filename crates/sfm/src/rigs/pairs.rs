//! Image pairs of one instant from two cameras of a rig, and their relative poses.
//!
//! Images are paired by time, each on its camera's own clock, so the clocks must agree to within
//! half the interval between images. An image without a time is in no pair. Unless most images of
//! each camera have times, images are paired by their names.

use tiepoint_rig::{RelativePose, interval_s};
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use super::candidates::rig_candidates;
use crate::frame_names::pairs_by_name;
use crate::timeline::images_in_time;

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
    let images = rig_candidates(scene);
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

/// Returns the pairs of mutually nearest images in time, closer than half the median interval.
pub(crate) fn by_time(references: &[(f64, ImageId)], others: &[(f64, ImageId)]) -> Vec<RigPair> {
    let interval = |images: &[(f64, ImageId)]| {
        interval_s(&images.iter().map(|(time_s, _)| *time_s).collect::<Vec<f64>>())
    };
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

/// Returns the pairs of images of one instant by their names.
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
    pairs.map(pair).collect()
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

    #[test]
    fn without_times_images_are_paired_by_file_name() {
        assert_eq!(pairs(&scene(&[None; 3], &[None, Some(0.0)])), [(0, 3), (1, 4)]);
        assert!(rig_pairs(&scene(&[None; 3], &[])).is_empty(), "a lone camera");
    }
}
