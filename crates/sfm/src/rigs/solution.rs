//! What comes out for the cameras of a rig.

use tiepoint_geometry::Rigid3;
use tiepoint_rig::RelativePoseStatistics;

use super::extrinsics::{ExtrinsicsCovariance, RigConstraint};
use super::pairs::RigPair;
use super::rig_sensor::RigSensor;

/// How the cameras of a model are held to each other, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedRig {
    /// How firmly; `None` where any mounting would have explained held-out tracks worse.
    pub constraint: Option<RigConstraint>,
    /// Each camera that is held to the first one.
    pub cameras: Vec<CalibratedCamera>,
    /// Images of one moment that agree with the mounting neither in the model nor by their own
    /// matches, and take no part in it.
    pub bad_pairs: Vec<RigPair>,
    /// Where a split of the model was closed.
    pub split: Option<ClosedSplit>,
    /// Error of the held-out tracks without any mounting, in pixels.
    pub error_off_px: f64,
    /// The same with the mountings, in pixels.
    pub error_px: f64,
}

/// The calibration of a camera that rides with the first one.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedCamera {
    /// Which cameras, and the other one's clock.
    pub rig_sensor: RigSensor,
    /// The calibration, in units of the model.
    pub right_from_left: Rigid3,
    /// Of calibration and clock; `None` where something is not determined. Along
    /// [`RigSensor::blind`] the camera is where it was believed to be, and that is known to a unit.
    pub covariance: Option<ExtrinsicsCovariance>,
    /// How firmly it is held.
    pub constraint: RigConstraint,
    /// Moments at which the two could be compared.
    pub num_referenced_images: usize,
    /// Of the relative poses at the moments that are held.
    pub statistics: Option<RelativePoseStatistics>,
}

/// Images that had no matches with their partners and stood elsewhere, and were brought back to
/// where their mounting has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClosedSplit {
    /// How many images.
    pub num_images: usize,
    /// Pairs that matched when they were matched again; with none, nothing but the mounting holds
    /// these images.
    pub num_pairs_matched_again: usize,
}
