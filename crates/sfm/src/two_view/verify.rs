//! Two-view verification: the matches of an image pair that one rigid scene explains.
//!
//! After Schönberger & Frahm 2016, section 4.1: an essential matrix if both cameras are calibrated,
//! a fundamental matrix otherwise, and a homography to detect planes and pure rotations. Pairs with
//! a spherical camera have an essential matrix alone, since its image is no plane.

use tiepoint_geometry::estimate;
use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_geometry::{RansacOptions, epipolar};
use tiepoint_scene::{Camera, Keypoint, Match, TwoView, TwoViewKind};

/// Thresholds of the verification.
#[derive(Clone, Copy, Debug)]
pub struct VerifyOptions {
    /// Maximum Sampson or transfer error of an inlier, in pixels.
    pub max_error_px: f64,
    /// Minimum number of inliers.
    pub min_num_inliers: usize,
    /// Minimum number of inliers of the essential matrix relative to the fundamental matrix. Below
    /// it the calibration is considered wrong.
    pub min_essential_share: f64,
    /// A homography with more than this fraction of the inliers indicates a plane or a pure
    /// rotation.
    pub max_homography_share: f64,
}

impl Default for VerifyOptions {
    fn default() -> Self {
        Self {
            max_error_px: 4.0,
            min_num_inliers: 15,
            min_essential_share: 0.95,
            max_homography_share: 0.8,
        }
    }
}

/// One image of a pair.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The keypoints of the image.
    pub keypoints: &'a [Keypoint],
    /// The camera of the image.
    pub camera: &'a Camera,
}

/// Verifies the matches of two images. `seed` is the seed of RANSAC.
pub fn verify_pair(
    view1: View,
    view2: View,
    matches: &[Match],
    options: &VerifyOptions,
    seed: u64,
) -> TwoView {
    let degenerate = TwoView { kind: TwoViewKind::Degenerate, ..TwoView::default() };
    if matches.len() < options.min_num_inliers {
        return degenerate;
    }
    let points1: Vec<Vector2<f64>> =
        matches.iter().map(|m| view1.keypoints[m.a as usize].pixel).collect();
    let points2: Vec<Vector2<f64>> =
        matches.iter().map(|m| view2.keypoints[m.b as usize].pixel).collect();
    let ransac =
        RansacOptions { max_error: options.max_error_px, seed, ..RansacOptions::default() };

    let essential = if view1.camera.is_calibrated() && view2.camera.is_calibrated() {
        estimate::relative_pose(
            &points1,
            &points2,
            &view1.camera.intrinsics,
            &view2.camera.intrinsics,
            &ransac,
        )
    } else {
        None
    };
    // The fundamental matrix cannot have more inliers than there are matches. If the essential
    // matrix has nearly all of them, the test of the calibration needs no fundamental matrix.
    let enough = options.min_essential_share * matches.len() as f64;
    let have_image_plane =
        [view1, view2].iter().all(|view| !view.camera.intrinsics.kind().focal_indices().is_empty());
    let fundamental = match &essential {
        _ if !have_image_plane => None,
        Some(report) if report.num_inliers as f64 >= enough => None,
        _ => estimate::fundamental(&points1, &points2, &ransac),
    };
    let num_fundamental = fundamental.as_ref().map_or(0, |report| report.num_inliers);
    let mut two_view = match (essential, fundamental) {
        (Some(e), _)
            if e.num_inliers as f64 >= options.min_essential_share * num_fundamental as f64 =>
        {
            let essential = epipolar::essential_from_pose(&e.model);
            TwoView {
                kind: TwoViewKind::Calibrated,
                essential: Some(essential),
                fundamental: epipolar::fundamental_from_essential(
                    &essential,
                    &view1.camera.intrinsics.calibration_matrix(),
                    &view2.camera.intrinsics.calibration_matrix(),
                )
                .filter(|_| have_image_plane),
                cam2_from_cam1: Some(e.model),
                matches: select(matches, &e.inliers),
                ..TwoView::default()
            }
        }
        (_, Some(f)) => TwoView {
            kind: TwoViewKind::Uncalibrated,
            fundamental: Some(f.model),
            matches: select(matches, &f.inliers),
            ..TwoView::default()
        },
        _ => return degenerate,
    };
    if two_view.matches.len() < options.min_num_inliers {
        return degenerate;
    }
    if !have_image_plane {
        return two_view;
    }
    let inliers1: Vec<Vector2<f64>> =
        two_view.matches.iter().map(|m| view1.keypoints[m.a as usize].pixel).collect();
    let inliers2: Vec<Vector2<f64>> =
        two_view.matches.iter().map(|m| view2.keypoints[m.b as usize].pixel).collect();
    let ransac = RansacOptions { min_inlier_ratio: options.max_homography_share, ..ransac };
    if let Some(homography) = estimate::homography(&inliers1, &inliers2, &ransac)
        && homography.num_inliers as f64 > options.max_homography_share * inliers1.len() as f64
    {
        two_view.kind = TwoViewKind::PlanarOrPanoramic;
        two_view.homography = Some(homography.model);
    }
    two_view
}

fn select(matches: &[Match], mask: &[bool]) -> Vec<Match> {
    matches.iter().zip(mask).filter(|(_, inlier)| **inlier).map(|(m, _)| *m).collect()
}
