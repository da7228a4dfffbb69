//! Errors of camera poses after alignment to the ground truth.

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::solvers::umeyama;
use tiepoint_geometry::{Intrinsics, Rigid3, Sim3};

/// Type of the transform that aligns a model to the ground truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Alignment {
    /// Rotation, translation and scale: for models of unknown scale.
    Similarity,
    /// Rotation and translation: for metric models.
    Rigid,
    /// Identity: for models in the frame of the ground truth.
    None,
}

impl Alignment {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Similarity, Self::Rigid, Self::None];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Similarity => "similarity",
            Self::Rigid => "rigid",
            Self::None => "none",
        }
    }

    /// The transform `to_from_from` with the least squared distances (Umeyama 1991); `None` for
    /// fewer than three points, or collinear ones.
    pub fn fit(self, from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Option<Sim3> {
        match self {
            Self::Similarity => umeyama(from, to, true),
            Self::Rigid => umeyama(from, to, false),
            Self::None => Some(Sim3::identity()),
        }
    }
}

/// Pose errors after alignment, one entry per image; `None` for images without a pose.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseComparison {
    /// The alignment.
    pub truth_from_model: Sim3,
    /// Distances between estimated and true centres, in units of the ground truth.
    pub centre_errors: Vec<Option<f64>>,
    /// Angles between estimated and true orientations, in radians.
    pub rotation_errors_rad: Vec<Option<f64>>,
}

/// Compares poses (`cam_from_world`) with the true ones after alignment of the camera centres.
/// `None` if the centres do not determine the alignment. The root mean square of the centre errors
/// is the ATE (Sturm et al. 2012).
pub fn compare_poses(
    model: &[Option<Rigid3>],
    truth: &[Rigid3],
    alignment: Alignment,
) -> Option<PoseComparison> {
    let pairs = || {
        model
            .iter()
            .zip(truth)
            .filter_map(|(model, truth)| model.as_ref().map(|model| (model, truth)))
    };
    let from: Vec<_> = pairs().map(|(model, _)| model.origin_in_a()).collect();
    let to: Vec<_> = pairs().map(|(_, truth)| truth.origin_in_a()).collect();
    let truth_from_model = alignment.fit(&from, &to)?;
    let compare = |(model, truth): (&Option<Rigid3>, &Rigid3)| {
        let model = truth_from_model.transform_pose(model.as_ref()?);
        let centre = (model.origin_in_a() - truth.origin_in_a()).norm();
        Some((centre, model.rotation.angle_to(&truth.rotation)))
    };
    let errors: Vec<Option<(f64, f64)>> = model.iter().zip(truth).map(compare).collect();
    Some(PoseComparison {
        truth_from_model,
        centre_errors: errors.iter().map(|error| error.map(|error| error.0)).collect(),
        rotation_errors_rad: errors.iter().map(|error| error.map(|error| error.1)).collect(),
    })
}

/// Relative error of the focal length: +0.01 is one percent too long.
pub fn focal_error(model: &Intrinsics, truth: &Intrinsics) -> f64 {
    model.mean_focal_px() / truth.mean_focal_px() - 1.0
}
