//! Selection of initial pairs by the number of matches that triangulate well.

use rayon::prelude::*;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::{RansacOptions, Rigid3, epipolar, estimate, triangulate};
use tiepoint_scene::{CorrespondenceGraph, ImagePair, Reconstruction, TwoView};

/// Triangulation angles from this size on, in radians, score 1.
const FULL_ANGLE_RAD: f64 = 16.0 * std::f64::consts::PI / 180.0;
/// Minimum triangulation angle, in radians.
const MIN_ANGLE_RAD: f64 = 1.0 * std::f64::consts::PI / 180.0;
/// A pair is scored on this many of its matches, evenly chosen.
const MAX_SCORED_MATCHES: usize = 500;
/// Factor on the score of pairs that a homography explains. Their pose is uncertain.
const PLANAR_FACTOR: f64 = 0.3;

/// A candidate for initialisation.
#[derive(Clone, Copy, Debug)]
pub struct InitialPair {
    /// The two images.
    pub pair: ImagePair,
    /// Relative pose with a translation of unit length.
    pub cam2_from_cam1: Rigid3,
    /// Number of matches that triangulate, each weighted by min(angle / 16°, 1).
    pub score: f64,
}

/// Returns at most `count` pairs among those that `is_free` accepts, best first. `max_error_px` is
/// the maximum reprojection error of a match.
pub fn initial_pairs(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    is_free: &(dyn Fn(ImagePair) -> bool + Sync),
    max_error_px: f64,
    count: usize,
) -> Vec<InitialPair> {
    let pairs: Vec<(&ImagePair, &TwoView)> =
        graph.pairs().iter().filter(|(pair, _)| is_free(**pair)).collect();
    let mut scored: Vec<InitialPair> = pairs
        .par_iter()
        .filter_map(|(pair, two_view)| {
            let cam2_from_cam1 = relative_pose(model, pair, two_view)?;
            let factor = if two_view.homography.is_some() { PLANAR_FACTOR } else { 1.0 };
            let score = factor * score_pair(model, pair, two_view, &cam2_from_cam1, max_error_px);
            Some(InitialPair { pair: **pair, cam2_from_cam1, score })
        })
        .collect();
    scored.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.pair.cmp(&b.pair)));
    scored.truncate(count);
    scored
}

/// Returns the relative pose from the verification, or the pose of its fundamental matrix with the
/// current intrinsics.
pub(crate) fn relative_pose(
    model: &Reconstruction,
    pair: &ImagePair,
    two_view: &TwoView,
) -> Option<Rigid3> {
    if let Some(pose) = two_view.cam2_from_cam1 {
        return Some(pose);
    }
    let (rays1, rays2) =
        rays(model, pair, two_view, two_view.matches.len().div_ceil(MAX_SCORED_MATCHES));
    let Some(fundamental) = two_view.fundamental else {
        // Pairs of fisheye images without focal lengths have no fundamental matrix.
        return estimate_pose(model, pair, two_view, 0);
    };
    let calibration1 = model.camera_of(pair.a).intrinsics.calibration_matrix();
    let calibration2 = model.camera_of(pair.b).intrinsics.calibration_matrix();
    let essential =
        epipolar::essential_from_fundamental(&fundamental, &calibration1, &calibration2);
    epipolar::pose_from_essential(&essential, &rays1, &rays2).map(|(pose, _)| pose)
}

/// Estimates the relative pose of a pair again with the current intrinsics.
pub(crate) fn estimate_relative_pose(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    pair: ImagePair,
    seed: u64,
) -> Option<Rigid3> {
    estimate_pose(model, &pair, graph.pairs().get(&pair)?, seed)
}

/// Estimates the relative pose of a pair from its matches with the current intrinsics.
fn estimate_pose(
    model: &Reconstruction,
    pair: &ImagePair,
    two_view: &TwoView,
    seed: u64,
) -> Option<Rigid3> {
    let pixels = |image, keypoint: u32| model.image(image).keypoints[keypoint as usize].pixel;
    let (points1, points2): (Vec<_>, Vec<_>) =
        two_view.matches.iter().map(|m| (pixels(pair.a, m.a), pixels(pair.b, m.b))).unzip();
    let (camera1, camera2) = (model.camera_of(pair.a), model.camera_of(pair.b));
    let options = RansacOptions { max_error: 4.0, seed, ..RansacOptions::default() };
    estimate::relative_pose(&points1, &points2, &camera1.intrinsics, &camera2.intrinsics, &options)
        .map(|r| r.model)
}

/// Every `step`-th match as unit rays.
fn rays(
    model: &Reconstruction,
    pair: &ImagePair,
    two_view: &TwoView,
    step: usize,
) -> (Vec<Vector3<f64>>, Vec<Vector3<f64>>) {
    let ray = |image, keypoint: u32| {
        let pixel = model.image(image).keypoints[keypoint as usize].pixel;
        model.camera_of(image).intrinsics.unproject(&pixel)
    };
    two_view
        .matches
        .iter()
        .step_by(step.max(1))
        .filter_map(|m| Some((ray(pair.a, m.a)?, ray(pair.b, m.b)?)))
        .unzip()
}

/// Σ min(angle / 16°, 1) over the matches that triangulate in front of both cameras with small
/// reprojection errors.
fn score_pair(
    model: &Reconstruction,
    pair: &ImagePair,
    two_view: &TwoView,
    cam2_from_cam1: &Rigid3,
    max_error_px: f64,
) -> f64 {
    let step = two_view.matches.len().div_ceil(MAX_SCORED_MATCHES).max(1);
    let (rays1, rays2) = rays(model, pair, two_view, step);
    let centre2 = cam2_from_cam1.origin_in_a();
    let max_error_rad = max_error_px / model.camera_of(pair.a).intrinsics.mean_focal_px();
    let scored = rays1.iter().zip(&rays2).filter_map(|(ray1, ray2)| {
        let point = triangulate::triangulate_two_view(ray1, ray2, cam2_from_cam1)?;
        let point2 = *cam2_from_cam1 * point;
        let ray_error_rad =
            |ray: &Vector3<f64>, point: &Vector3<f64>| ray.cross(point).norm() / point.norm();
        let fits = ray1.dot(&point) > 0.0
            && ray2.dot(&point2) > 0.0
            && ray_error_rad(ray1, &point) < max_error_rad
            && ray_error_rad(ray2, &point2) < max_error_rad;
        let angle = triangulate::triangulation_angle(&Vector3::zeros(), &centre2, &point);
        (fits && angle > MIN_ANGLE_RAD).then_some((angle / FULL_ANGLE_RAD).min(1.0))
    });
    scored.sum::<f64>() * step as f64
}
