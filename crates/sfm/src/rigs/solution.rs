//! What comes out for the cameras of a rig.

use tiepoint_geometry::Rigid3;
use tiepoint_rig::Spread;

use super::companion::Companion;
use super::mounting::{Hold, MountingCovariance};
use super::pairs::RigPair;

/// How the cameras of a model are held to each other, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct MountedRig {
    /// How firmly; `None` where any mounting would have explained held-out tracks worse.
    pub hold: Option<Hold>,
    /// Each camera that is held to the first one.
    pub cameras: Vec<MountedCamera>,
    /// Images of one moment that agree with the mounting neither in the model nor by their own matches, and take no part in it.
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
pub struct MountedCamera {
    /// Which cameras, and the other one's clock.
    pub companion: Companion,
    /// The calibration, in units of the model.
    pub right_from_left: Rigid3,
    /// Of calibration and clock; `None` where something is not determined. Along [`Companion::blind`] the camera is where it was believed to be, and
    /// that is known to a unit.
    pub covariance: Option<MountingCovariance>,
    /// How firmly it is held.
    pub hold: Hold,
    /// Moments at which the two could be compared.
    pub num_moments: usize,
    /// Of the relative poses at the moments that are held.
    pub spread: Option<Spread>,
}

/// Images that had no matches with their partners and stood elsewhere, and were brought back to where their mounting has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClosedSplit {
    /// How many images.
    pub num_images: usize,
    /// Pairs that matched when they were matched again; with none, nothing but the mounting holds these images.
    pub num_pairs_matched_again: usize,
}
