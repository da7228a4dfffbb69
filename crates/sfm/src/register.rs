//! The pose of one more image, from its keypoints that match keypoints which see points.

use std::collections::BTreeSet;

use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{RansacOptions, estimate};
use tiepoint_scene::{CorrespondenceGraph, ImageId, Observation, PointId, Reconstruction};

/// What counts as registered.
#[derive(Clone, Copy, Debug)]
pub struct RegisterOptions {
    /// Largest distance between a keypoint and the projection of its point, in pixels.
    pub max_error_px: f64,
    /// Fewer inliers are no pose.
    pub min_num_inliers: usize,
    /// A smaller share of inliers is no pose.
    pub min_inlier_share: f64,
}

impl Default for RegisterOptions {
    fn default() -> Self {
        Self { max_error_px: 12.0, min_num_inliers: 30, min_inlier_share: 0.25 }
    }
}

/// Estimates the pose of `image`, sets it and lets its inlier keypoints see their points. Returns how many; `None`, and nothing
/// changes, where too few agree.
pub fn register_image(
    graph: &CorrespondenceGraph,
    model: &mut Reconstruction,
    image: ImageId,
    options: &RegisterOptions,
    seed: u64,
) -> Option<usize> {
    let candidates = candidates(graph, model, image);
    if candidates.len() < options.min_num_inliers {
        return None;
    }
    let pixels: Vec<Vector2<f64>> = candidates
        .iter()
        .map(|(keypoint, _)| model.image(image).keypoints[*keypoint as usize].pixel)
        .collect();
    let points: Vec<Vector3<f64>> =
        candidates.iter().filter_map(|(_, point)| model.track(*point)).map(|track| track.xyz).collect();
    let ransac = RansacOptions { max_error: options.max_error_px, seed, ..RansacOptions::default() };
    let report = estimate::absolute_pose(&pixels, &points, &model.camera_of(image).intrinsics, &ransac)?;
    let share = report.num_inliers as f64 / candidates.len() as f64;
    if report.num_inliers < options.min_num_inliers || share < options.min_inlier_share {
        return None;
    }
    model.register(image, report.model);
    for ((keypoint, point), _) in candidates.iter().zip(&report.inliers).filter(|(_, inlier)| **inlier) {
        model.add_observation(*point, Observation { image, keypoint: *keypoint });
    }
    Some(report.num_inliers)
}

/// Keypoints with the points that their correspondences see; a keypoint may have several.
fn candidates(graph: &CorrespondenceGraph, model: &Reconstruction, image: ImageId) -> Vec<(u32, PointId)> {
    let mut candidates = Vec::new();
    for keypoint in 0..model.image(image).keypoints.len() as u32 {
        let points: BTreeSet<PointId> = graph
            .correspondences(Observation { image, keypoint })
            .iter()
            .filter_map(|t| model.image(t.image).point_of(t.keypoint))
            .filter(|point| model.track(*point).is_some())
            .collect();
        candidates.extend(points.into_iter().map(|point| (keypoint, point)));
    }
    candidates
}
