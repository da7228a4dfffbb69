//! Results of the rig calibration.

use tiepoint_geometry::Rigid3;
use tiepoint_rig::RelativePoseStatistics;
use tiepoint_scene::CameraId;

use super::extrinsics::{ExtrinsicsCovariance, RigConstraint};
use super::held_out::HeldOutChange;
use super::pairs::RigPair;
use super::sensor_pair::SensorPair;

/// Constraint of a model's cameras, their calibration, and the errors that led to the choice.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedRig {
    /// The loosest constraint of a camera; `None` if every constraint increased the error of the
    /// held-out tracks.
    pub constraint: Option<RigConstraint>,
    /// The calibration of each constrained camera.
    pub cameras: Vec<CalibratedCamera>,
    /// Pairs of one instant that agree with the extrinsics neither in the model nor by their
    /// two-view geometry. They are not constrained.
    pub bad_pairs: Vec<RigPair>,
    /// Set if a split of the model was repaired.
    pub split: Option<SplitRepair>,
    /// Error of the held-out tracks without a rig constraint, in pixels.
    pub error_off_px: f64,
    /// Error of the held-out tracks with the constraint, in pixels.
    pub error_px: f64,
    /// Change of this error by the constraint; `None` without a constraint, or if the held-out
    /// tracks do not spread over the drive.
    pub held_out_change: Option<HeldOutChange>,
    /// Cameras that permit no constraint although others do.
    pub unconstrained: Vec<CameraId>,
    /// With a soft constraint: why it is not tighter.
    pub limit: Option<ConstraintLimit>,
}

/// Why a soft constraint has no smaller standard deviations, or is not rigid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ConstraintLimit {
    /// The next smaller ones increase the error of the held-out tracks too much, to `error_px`.
    HeldOutError {
        /// In pixels.
        error_px: f64,
    },
    /// The relative poses deviate by more than smaller ones allow.
    Residuals,
    /// Smaller ones of the rotation increase the error, or its residuals are larger than they
    /// allow, as for a mount that moves.
    FlexibleRotation,
    /// Rigid frames need synchronised cameras, and no two are.
    Unsynchronised,
    /// They are the smallest, and a rigid rig increases the error of the held-out tracks too much,
    /// to `error_px`.
    RigidIsWorse {
        /// In pixels.
        error_px: f64,
    },
    /// They are the smallest, and [`crate::RigMode::Soft`] was asked for.
    Smallest,
}

/// Calibration of a camera relative to the reference camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedCamera {
    /// The cameras and the clock.
    pub sensor_pair: SensorPair,
    /// Extrinsics, in units of the model.
    pub cam_from_rig: Rigid3,
    /// Cluster-robust covariance of extrinsics and clock; `None` if something is not determined.
    /// Along [`SensorPair::unobservable_direction`] the centre has the prior's mean, zero, and a
    /// standard deviation of one assumed baseline.
    pub covariance: Option<ExtrinsicsCovariance>,
    /// The constraint.
    pub constraint: RigConstraint,
    /// Number of images whose relative pose is defined.
    pub num_referenced_images: usize,
    /// Statistics of the relative poses of the constrained images.
    pub statistics: Option<RelativePoseStatistics>,
}

/// A repaired split: images whose poses were far from those that the extrinsics give, and which had
/// no matches with the images of the other cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplitRepair {
    /// Number of images.
    pub num_images: usize,
    /// Number of image pairs verified after guided matching. If zero, only the rig constraint
    /// connects these images.
    pub num_rematched_pairs: usize,
}
