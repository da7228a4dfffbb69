//! Guided matching of images of a repaired split.
//!
//! These images have no matches across cameras. Only the rig constraint connects them, and without
//! it the split opens again. With the poses known, they are matched along epipolar lines with their
//! reference images and the neighbours of those. The new pairs must pass two-view verification,
//! which does not use the poses.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use tiepoint_geometry::nalgebra::{Matrix3, Vector3};
use tiepoint_geometry::{Rng, epipolar};
use tiepoint_matching::features::{self, Features, Keypoint};
use tiepoint_matching::{EpipolarGuide, Options, match_guided};
use tiepoint_scene::{
    Camera, CorrespondenceGraph, ImageId, ImagePair, Match, Reconstruction, TwoView,
};

use super::extrinsics::SplitImage;
use crate::two_view::{ImageObservations, VerifyOptions, verify_pair};

/// Returns the descriptors of an image in the order of its keypoints; empty if there are none.
pub type Descriptors<'a> = dyn FnMut(ImageId) -> features::Descriptors + 'a;

/// Maximum distance from the epipolar line, in pixels. The value is large because the poses come
/// from the rig constraint and not from these images.
const MAX_GUIDE_ERROR_PX: f64 = 8.0;

/// Matches each image of the split with its reference image and with the graph neighbours of that
/// one. Returns the verified pairs, which the graph does not have yet.
pub(super) fn rematch(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    split_images: &BTreeSet<SplitImage>,
    descriptors: &mut Descriptors,
    seed: u64,
) -> Vec<(ImagePair, TwoView)> {
    let pairs_of = |split: &SplitImage| {
        let of_reference = graph.neighbours(split.reference);
        let others: BTreeSet<ImageId> =
            std::iter::once(&split.reference).chain(of_reference).copied().collect();
        let has_pose = |image: &ImageId| model.image(*image).cam_from_world().is_some();
        let pairs = others.into_iter().filter(has_pose);
        let pairs = pairs.filter_map(|other| ImagePair::new(split.image, other));
        pairs.filter(|pair| !graph.pairs().contains_key(pair)).collect::<Vec<_>>()
    };
    let mut found: BTreeMap<ImagePair, TwoView> = BTreeMap::new();
    // Cache. Consecutive images share most of their neighbours.
    let mut features: BTreeMap<ImageId, Features> = BTreeMap::new();
    for split in split_images {
        let pairs: Vec<ImagePair> =
            pairs_of(split).into_iter().filter(|pair| !found.contains_key(pair)).collect();
        let needed: BTreeSet<ImageId> = pairs.iter().flat_map(|pair| [pair.a, pair.b]).collect();
        features.retain(|image, _| needed.contains(image));
        for image in needed {
            features
                .entry(image)
                .or_insert_with(|| undistorted_features(model, image, descriptors(image)));
        }
        let two_view = |pair: &ImagePair| {
            let matches = guided_matches(model, pair, &features[&pair.a], &features[&pair.b])?;
            let camera = |image| Camera { has_focal_prior: true, ..*model.camera_of(image) };
            let (camera_a, camera_b) = (camera(pair.a), camera(pair.b));
            let a =
                ImageObservations { keypoints: &model.image(pair.a).keypoints, camera: &camera_a };
            let b =
                ImageObservations { keypoints: &model.image(pair.b).keypoints, camera: &camera_b };
            let seed = Rng::stream(seed, &[u64::from(pair.a.0), u64::from(pair.b.0)]).next_u64();
            Some((*pair, verify_pair(a, b, &matches, &VerifyOptions::default(), seed)))
        };
        found.extend(pairs.par_iter().filter_map(two_view).collect::<Vec<_>>());
    }
    found.into_iter().filter(|(_, two_view)| two_view.is_verified()).collect()
}

/// Projects keypoints to a pinhole camera with the principal point at the origin, where epipolar
/// lines are straight. Rays with z ≤ 0 give NaN. Returns no features if the number of descriptors
/// differs from the number of keypoints.
fn undistorted_features(
    model: &Reconstruction,
    image: ImageId,
    descriptors: features::Descriptors,
) -> Features {
    let (intrinsics, keypoints) =
        (&model.camera_of(image).intrinsics, &model.image(image).keypoints);
    if descriptors.len() != keypoints.len() {
        return Features::default();
    }
    let focal_px = intrinsics.mean_focal_px();
    // Epipolar lines are lines in the plane z = 1, which has no rays behind the camera.
    let keypoint = |keypoint: &tiepoint_scene::Keypoint| {
        let ray = intrinsics.unproject(&keypoint.pixel).filter(|ray| ray.z > 0.0);
        let [x, y] = ray.map_or([f32::NAN; 2], |ray| {
            [(focal_px * ray.x / ray.z) as f32, (focal_px * ray.y / ray.z) as f32]
        });
        Keypoint { x, y, scale: keypoint.scale_px, orientation: 0.0 }
    };
    Features { keypoints: keypoints.iter().map(keypoint).collect(), descriptors }
}

/// Matches two images along the epipolar lines of their poses.
fn guided_matches(
    model: &Reconstruction,
    pair: &ImagePair,
    a: &Features,
    b: &Features,
) -> Option<Vec<Match>> {
    let pose = |image| model.image(image).cam_from_world();
    let b_from_a = *pose(pair.b)? * pose(pair.a)?.inverse();
    let calibration = |image| {
        let focal_px = model.camera_of(image).intrinsics.mean_focal_px();
        Matrix3::from_diagonal(&Vector3::new(focal_px, focal_px, 1.0))
    };
    let essential = epipolar::essential_from_pose(&b_from_a);
    let fundamental = epipolar::fundamental_from_essential(
        &essential,
        &calibration(pair.a),
        &calibration(pair.b),
    )?;
    let guide = EpipolarGuide {
        fundamental: std::array::from_fn(|row| {
            std::array::from_fn(|column| fundamental[(row, column)])
        }),
        max_error_px: MAX_GUIDE_ERROR_PX,
    };
    let matches = match_guided(a, b, &guide, &Options::default());
    Some(matches.into_iter().map(|m| Match { a: m.a, b: m.b }).collect())
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::nalgebra::Vector2;
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_scene::{Image, Keypoint as ScenePoint, TwoViewKind};

    use super::*;

    const POINTS: usize = 400;
    /// Points with the descriptor of another point, as repeated windows have. The ratio test
    /// rejects them without an epipolar line.
    const NUM_REPEATED: usize = 200;
    /// Focal length of a fisheye, so that epipolar lines are curved in the image.
    const FOCAL_PX: f64 = 200.0;
    /// Some repeated points lie on the same epipolar line.
    const MIN_SHARE: f64 = 0.8;

    /// Three images of the same points: two of the reference camera, which match, and one of the
    /// other camera without matches.
    fn scene() -> (Reconstruction, CorrespondenceGraph) {
        let mut rng = Rng::stream(1, &[]);
        let mut model = Reconstruction::default();
        let intrinsics = Intrinsics::centred(CameraModelKind::OpencvFisheye, FOCAL_PX, 640, 480);
        let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: false };
        let cameras = [model.add_camera(camera), model.add_camera(camera)];
        let points: Vec<Vector3<f64>> = (0..POINTS)
            .map(|_| {
                let mut span = || 2.0 * rng.uniform() - 1.0;
                Vector3::new(6.0 * span(), 4.0 * span(), 7.0 + 2.0 * span())
            })
            .collect();
        let pose = |x: f64, z: f64| {
            Rigid3::from_axis_angle(
                Vector3::new(0.0, 0.05 * x, 0.01),
                Vector3::new(-x, 0.1 * x, -z),
            )
        };
        let poses = [(0, pose(0.0, 0.0)), (0, pose(0.1, 0.8)), (1, pose(0.5, 0.0))];
        for (index, (camera, pose)) in poses.into_iter().enumerate() {
            let seen = points.iter().map(|xyz| intrinsics.project(&(pose * *xyz)).unwrap());
            let keypoint = |pixel: Vector2<f64>| ScenePoint { pixel, scale_px: 2.0 };
            let keypoints = seen.map(keypoint).collect();
            let image =
                model.add_image(Image::new(format!("{index}.png"), cameras[camera], keypoints));
            model.register(image, pose);
        }
        let matches = (0..POINTS as u32).map(|k| Match { a: k, b: k }).collect();
        let two_view = TwoView { kind: TwoViewKind::Calibrated, matches, ..TwoView::default() };
        let pair = ImagePair::new(ImageId(0), ImageId(1)).unwrap();
        (model, CorrespondenceGraph::new(&[POINTS; 3], [(pair, two_view)]))
    }

    fn descriptor(k: usize) -> features::SiftDescriptor {
        let mut rng = Rng::stream(2, &[(k % (POINTS - NUM_REPEATED)) as u64]);
        std::array::from_fn(|_| rng.below(90) as u8)
    }

    #[test]
    fn a_split_image_is_matched_with_its_reference_image_and_that_ones_neighbours() {
        let (model, graph) = scene();
        let split_images =
            BTreeSet::from([SplitImage { image: ImageId(2), reference: ImageId(0) }]);
        let mut asked = Vec::new();
        let mut descriptors = |image| {
            asked.push(image);
            (0..POINTS).map(descriptor).collect()
        };
        let found = rematch(&graph, &model, &split_images, &mut descriptors, 0);
        assert_eq!(asked, [ImageId(0), ImageId(1), ImageId(2)], "each is read once");
        let pairs: Vec<(u32, u32)> = found.iter().map(|(pair, _)| (pair.a.0, pair.b.0)).collect();
        assert_eq!(pairs, [(0, 2), (1, 2)]);
        for (_, two_view) in &found {
            let right = two_view.matches.iter().filter(|m| m.a == m.b).count();
            assert_eq!(right, two_view.matches.len(), "repeated points are told apart");
            assert!(right as f64 >= MIN_SHARE * POINTS as f64, "{right}");
        }
        let extended = graph.extended(found);
        assert_eq!(extended.pairs().len(), 3);
    }

    #[test]
    fn without_descriptors_there_are_no_further_pairs() {
        let (model, graph) = scene();
        let split_images =
            BTreeSet::from([SplitImage { image: ImageId(2), reference: ImageId(0) }]);
        assert_eq!(rematch(&graph, &model, &split_images, &mut |_| Default::default(), 0), []);
    }
}
