//! Poses of images in a finished model, which does not change.

use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{Intrinsics, Loss, RansacOptions, Rigid3, estimate};
use tiepoint_scene::{CorrespondenceGraph, ImageId, Observation, PointId, Reconstruction};

use super::absolute_pose::{RegistrationUnit, candidates, estimate_placement};
use super::evidence::Evidence;
use super::options::RegisterOptions;

/// Scale of the Cauchy loss of the refinement, in pixels: 95 % efficiency for keypoints with a
/// standard deviation of a pixel (Holland and Welsch 1977).
const LOSS_SCALE_PX: f64 = 2.385;

/// Intrinsics that an image may have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QueryCamera {
    /// The intrinsics; an initial guess if the focal length is unknown.
    pub intrinsics: Intrinsics,
    /// Whether the focal length is known. An unknown one is estimated with the pose.
    pub is_focal_known: bool,
}

/// The pose of an image in a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Localization {
    /// The pose.
    pub cam_from_world: Rigid3,
    /// Its intrinsics.
    pub intrinsics: Intrinsics,
    /// Index of the camera that they are of.
    pub camera: usize,
    /// Keypoints with the points that they observe: each keypoint and each point once.
    pub inliers: Vec<(u32, PointId)>,
    /// Number of keypoints with a point before the estimation; a keypoint with two counts twice.
    pub num_candidates: usize,
}

/// Estimates the pose of an image from the points that its correspondences observe: RANSAC with
/// each of `cameras`, of which the one with most inliers is taken, the first of equals, and a
/// robust refinement over the inliers. `None` if none gives enough. `model` changes in the
/// intrinsics of the image's camera alone, which no other image may have.
///
/// `max_error_px`: maximum reprojection error of an inlier after the refinement, in pixels.
pub fn localize_image(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    image: ImageId,
    cameras: &[QueryCamera],
    options: &RegisterOptions,
    max_error_px: f64,
    seed: u64,
) -> Option<Localization> {
    let found = candidates(graph, model, image);
    let own = model.image(image).camera;
    let mut best: Option<(usize, usize)> = None;
    let mut placements = Vec::new();
    for (index, camera) in cameras.iter().enumerate() {
        let intrinsics = if camera.is_focal_known {
            Some(camera.intrinsics)
        } else {
            with_estimated_focal(model, &found, &camera.intrinsics, options, seed)
        };
        let Some(intrinsics) = intrinsics else { continue };
        model.camera_mut(own).intrinsics = intrinsics;
        let placement = estimate_placement(
            graph,
            model,
            &RegistrationUnit::Image(image),
            options,
            Evidence::Usual,
            seed,
            None,
        );
        let Some(placement) = placement else { continue };
        let count = placement.inliers.len();
        if best.is_none_or(|(most, _)| count > most) {
            best = Some((count, placements.len()));
        }
        placements.push((index, intrinsics, placement));
    }
    let (camera, intrinsics, placement) = placements.swap_remove(best?.1);
    model.camera_mut(own).intrinsics = intrinsics;
    let (pixels, points) = pixels_and_points(model, &placement.inliers);
    let cam_from_world = estimate::refine_absolute_pose(
        &pixels,
        &points,
        &intrinsics,
        &placement.poses[0].1,
        Loss::Cauchy(LOSS_SCALE_PX),
    );
    let error_px2 = |index: usize| {
        let error = intrinsics.squared_error_px2(&(cam_from_world * points[index]), &pixels[index]);
        error.unwrap_or(f64::INFINITY)
    };
    // The best keypoint of a point, and the best point of a keypoint.
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|a, b| error_px2(*a).total_cmp(&error_px2(*b)).then(a.cmp(b)));
    let mut inliers: Vec<(u32, PointId)> = Vec::new();
    let mut seen = std::collections::BTreeSet::new();
    let mut used = std::collections::BTreeSet::new();
    for index in order {
        let (Observation { keypoint, .. }, point) = placement.inliers[index];
        let fits = error_px2(index) <= max_error_px * max_error_px;
        if fits && !used.contains(&keypoint) && seen.insert(point) {
            used.insert(keypoint);
            inliers.push((keypoint, point));
        }
    }
    inliers.sort_unstable();
    let num_candidates = found.len();
    Some(Localization { cam_from_world, intrinsics, camera, inliers, num_candidates })
}

/// The intrinsics with the focal length that fits the points best.
fn with_estimated_focal(
    model: &Reconstruction,
    candidates: &[(Observation, PointId)],
    intrinsics: &Intrinsics,
    options: &RegisterOptions,
    seed: u64,
) -> Option<Intrinsics> {
    if candidates.len() < options.min_num_inliers {
        return None;
    }
    let (pixels, points) = pixels_and_points(model, candidates);
    let ransac =
        RansacOptions { max_error: options.max_error_px, seed, ..RansacOptions::default() };
    let report = estimate::absolute_pose_focal(&pixels, &points, intrinsics, &ransac)?;
    Some(report.model.1)
}

/// The pixels of keypoints and the positions of their points.
fn pixels_and_points(
    model: &Reconstruction,
    observations: &[(Observation, PointId)],
) -> (Vec<Vector2<f64>>, Vec<Vector3<f64>>) {
    let found = observations.iter().filter_map(|&(Observation { image, keypoint }, point)| {
        Some((model.image(image).keypoints[keypoint as usize].pixel, model.track(point)?.xyz))
    });
    found.unzip()
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::{CameraModelKind, Rng};
    use tiepoint_scene::{
        Camera, Image, ImagePair, Keypoint, Match, Observation, Track, TwoView, TwoViewKind,
    };

    use super::*;

    const POINTS: usize = 120;
    const WRONG: usize = 40;

    /// Two images of points in a box, and a query with wrong matches. Returns the pose of the
    /// query.
    fn scene(focal_px: f64) -> (CorrespondenceGraph, Reconstruction, ImageId, Rigid3) {
        let intrinsics = |focal_px| {
            Intrinsics::new(CameraModelKind::SimplePinhole, &[focal_px, 320.0, 240.0]).unwrap()
        };
        let camera = |focal_px| Camera {
            intrinsics: intrinsics(focal_px),
            width: 640,
            height: 480,
            has_focal_prior: true,
        };
        let poses = [0.0, 1.0, 0.4].map(|x| {
            Rigid3::from_axis_angle(Vector3::new(0.0, 0.1 * x, 0.02), Vector3::new(-x, 0.1, 0.0))
        });
        let mut model = Reconstruction::default();
        let known = model.add_camera(camera(500.0));
        let own = model.add_camera(camera(500.0));
        let mut rng = Rng::stream(3, &[]);
        let points: Vec<Vector3<f64>> = (0..POINTS)
            .map(|_| {
                let [x, y, z] = [0; 3].map(|_| rng.uniform());
                Vector3::new(2.0 * x - 0.5, 2.0 * y - 1.0, 4.0 + 3.0 * z)
            })
            .collect();
        let mut images = Vec::new();
        for (index, pose) in poses.iter().enumerate() {
            let focal_px = if index == 2 { focal_px } else { 500.0 };
            let pixel = |(k, xyz): (usize, &Vector3<f64>)| {
                let is_wrong = index == 2 && k < WRONG;
                let pixel = intrinsics(focal_px).project(&(*pose * *xyz)).unwrap();
                let wrong = Vector2::new(640.0 * rng.uniform(), 480.0 * rng.uniform());
                Keypoint { pixel: if is_wrong { wrong } else { pixel }, scale_px: 1.0 }
            };
            let keypoints = points.iter().enumerate().map(pixel).collect();
            let camera = if index == 2 { own } else { known };
            images.push(model.add_image(Image::new(index.to_string(), camera, keypoints)));
            if index < 2 {
                model.register(images[index], *pose);
            }
        }
        for (keypoint, xyz) in (0u32..).zip(&points) {
            let seen = images[..2].iter().map(|image| Observation { image: *image, keypoint });
            model.add_track(Track::new(*xyz, seen.collect()));
        }
        let matches = (0..POINTS as u32).map(|k| Match { a: k, b: k }).collect();
        let view = TwoView { kind: TwoViewKind::Calibrated, matches, ..TwoView::default() };
        let pair = ImagePair::new(images[0], images[2]).unwrap();
        let graph = CorrespondenceGraph::new(&[POINTS; 3], [(pair, view)]);
        (graph, model, images[2], poses[2])
    }

    #[test]
    fn pose_and_focal_length_are_found_among_wrong_matches() {
        let guess = |focal_px, is_focal_known| QueryCamera {
            intrinsics: Intrinsics::new(CameraModelKind::SimplePinhole, &[focal_px, 320.0, 240.0])
                .unwrap(),
            is_focal_known,
        };
        let find = |focal_px, cameras: &[QueryCamera]| {
            let (graph, mut model, image, pose) = scene(focal_px);
            let before = model.num_observations();
            let options = RegisterOptions::default();
            let found = localize_image(&graph, &mut model, image, cameras, &options, 4.0, 1);
            assert_eq!((model.num_observations(), model.num_registered()), (before, 2));
            found.map(|found| {
                ((found.cam_from_world.origin_in_a() - pose.origin_in_a()).norm(), found)
            })
        };
        let (error, found) = find(500.0, &[guess(800.0, true), guess(500.0, true)]).unwrap();
        assert!(error < 1e-6 && found.camera == 1, "{error} {found:?}");
        assert!((POINTS - WRONG..POINTS - WRONG + 5).contains(&found.inliers.len()));
        assert_eq!(found.num_candidates, POINTS);
        let (error, found) = find(900.0, &[guess(600.0, false)]).unwrap();
        assert!((found.intrinsics.mean_focal_px() - 900.0).abs() < 1e-3, "{found:?}");
        assert!(error < 1e-5, "{error}");
        assert!(find(500.0, &[]).is_none());
    }
}
