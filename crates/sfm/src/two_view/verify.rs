//! Two-view verification: the matches of an image pair that one rigid scene explains.
//!
//! After Schönberger & Frahm 2016, section 4.1: an essential matrix if both cameras are calibrated,
//! a fundamental matrix otherwise, and a homography to detect planes and pure rotations. Pairs with
//! a spherical camera have an essential matrix alone, since its image is no plane. Neither is that
//! of a fisheye: without a focal length, relative poses are estimated at several focal lengths, and
//! the one with the most inliers selects the matches.

use tiepoint_geometry::estimate;
use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_geometry::{OptionError, RansacOptions, epipolar};
use tiepoint_scene::{Camera, ImageId, Keypoint, Match, Reconstruction, TwoView, TwoViewKind};

use super::focal::with_focal;

/// Thresholds of the verification.
#[derive(Clone, Copy, Debug)]
pub struct VerifyOptions {
    /// Maximum Sampson or transfer error of an inlier, in pixels.
    pub max_error_px: f64,
    /// Minimum number of inliers.
    pub min_num_inliers: usize,
    /// Minimum number of inliers of the essential matrix relative to the fundamental matrix. Below
    /// it the calibration is considered wrong.
    pub min_e_f_inlier_ratio: f64,
    /// A homography with more than this fraction of the inliers indicates a plane or a pure
    /// rotation.
    pub max_h_inlier_ratio: f64,
}

impl VerifyOptions {
    /// Checks the ranges.
    ///
    /// # Errors
    ///
    /// Names the first option that is out of range.
    pub fn validate(&self) -> Result<(), OptionError> {
        OptionError::check_positive("verify.max_error_px", self.max_error_px)?;
        let least = self.min_num_inliers;
        OptionError::check("verify.min_num_inliers", least as f64, least >= 1, "at least 1")?;
        OptionError::check_ratio("verify.min_e_f_inlier_ratio", self.min_e_f_inlier_ratio)?;
        OptionError::check_ratio("verify.max_h_inlier_ratio", self.max_h_inlier_ratio)
    }
}

impl Default for VerifyOptions {
    fn default() -> Self {
        Self {
            max_error_px: 4.0,
            min_num_inliers: 15,
            min_e_f_inlier_ratio: 0.95,
            max_h_inlier_ratio: 0.8,
        }
    }
}

/// One image of a pair.
#[derive(Clone, Copy, Debug)]
pub struct ImageObservations<'a> {
    /// The keypoints of the image.
    pub keypoints: &'a [Keypoint],
    /// The camera of the image.
    pub camera: &'a Camera,
}

impl<'a> ImageObservations<'a> {
    /// Those of an image of a scene.
    pub fn new(scene: &'a Reconstruction, image: ImageId) -> Self {
        Self { keypoints: &scene.image(image).keypoints, camera: scene.camera_of(image) }
    }
}

/// Verifies the matches of two images. `seed` is the seed of RANSAC.
pub fn verify_pair(
    view1: ImageObservations,
    view2: ImageObservations,
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
    let enough = options.min_e_f_inlier_ratio * matches.len() as f64;
    if essential.is_none() && [view1, view2].iter().any(is_unknown_fisheye) {
        let matches = unknown_fisheye_matches(view1, view2, &points1, &points2, matches, &ransac);
        return if matches.len() < options.min_num_inliers {
            degenerate
        } else {
            TwoView { kind: TwoViewKind::Uncalibrated, matches, ..TwoView::default() }
        };
    }
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
            if e.num_inliers as f64 >= options.min_e_f_inlier_ratio * num_fundamental as f64 =>
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
    let ransac = RansacOptions { min_inlier_ratio: options.max_h_inlier_ratio, ..ransac };
    if let Some(homography) = estimate::homography(&inliers1, &inliers2, &ransac)
        && homography.num_inliers as f64 > options.max_h_inlier_ratio * inliers1.len() as f64
    {
        two_view.kind = TwoViewKind::PlanarOrPanoramic;
        two_view.homography = Some(homography.model);
    }
    two_view
}

/// Trial focal lengths of a fisheye relative to the larger side of its image: equidistant views of
/// 318° to 48°, 37 % apart. They only select matches; the focal length is estimated from all pairs.
const FISHEYE_TRIALS: [f64; 7] = [0.18, 0.25, 0.34, 0.46, 0.63, 0.87, 1.2];

/// Whether a view is a fisheye without a known focal length.
fn is_unknown_fisheye(view: &ImageObservations) -> bool {
    !view.camera.is_calibrated() && view.camera.intrinsics.kind().is_fisheye()
}

/// The matches that a relative pose explains at the best of several focal lengths. All cameras
/// without a focal length get the same one relative to their images.
fn unknown_fisheye_matches(
    view1: ImageObservations,
    view2: ImageObservations,
    points1: &[Vector2<f64>],
    points2: &[Vector2<f64>],
    matches: &[Match],
    ransac: &RansacOptions,
) -> Vec<Match> {
    let trial = |view: &ImageObservations, relative: f64| {
        let Camera { intrinsics, width, height, .. } = *view.camera;
        if view.camera.is_calibrated() {
            return intrinsics;
        }
        with_focal(&intrinsics, relative * f64::from(width.max(height)))
    };
    let mut best: (usize, Vec<Match>) = (0, Vec::new());
    for relative in FISHEYE_TRIALS {
        let (one, other) = (trial(&view1, relative), trial(&view2, relative));
        let report = estimate::relative_pose(points1, points2, &one, &other, ransac);
        if let Some(report) = report.filter(|report| report.num_inliers > best.0) {
            best = (report.num_inliers, select(matches, &report.inliers));
        }
    }
    best.1
}

fn select(matches: &[Match], mask: &[bool]) -> Vec<Match> {
    matches.iter().zip(mask).filter(|(_, inlier)| **inlier).map(|(m, _)| *m).collect()
}
