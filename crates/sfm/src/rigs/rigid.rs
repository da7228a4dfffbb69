//! A finished model made rigid, whatever it was: each further camera with one calibration, exactly, at every moment.
//!
//! The further cameras are moved to where the calibration has them; then everything is adjusted, calibration, lenses and points included,
//! with their poses being no variables at all.

use tiepoint_ba::Summary;
use tiepoint_geometry::Rigid3;
use tiepoint_rig::Clock;
use tiepoint_scene::{CameraId, Reconstruction};

use super::companion::{Companion, Left, Moment, Timing};
use super::frames::make_frames;
use super::mounting::{Hold, Mounting};
use super::mounting_term::adjust_mounted;
use super::pairs::RigPair;
use crate::Error;
use crate::adjust::AdjustOptions;
use crate::tracks::{FilterOptions, filter_all_points};

/// A camera to be held exactly.
#[derive(Clone, Debug, PartialEq)]
pub struct RigidCamera {
    /// The first camera.
    pub left: CameraId,
    /// The other one.
    pub right: CameraId,
    /// The calibration to begin with; it is adjusted.
    pub right_from_left: Rigid3,
    /// Images of one moment. Others of the camera stay free.
    pub pairs: Vec<RigPair>,
}

/// Holds cameras exactly, adjusts the model, drops observations that no longer fit, and makes the moments the model's frames.
pub fn hold_rigidly(
    model: &mut Reconstruction,
    cameras: &mut [RigidCamera],
    options: &AdjustOptions,
    filter: &FilterOptions,
) -> Result<Summary, Error> {
    model.frames.clear();
    model.rigs.clear();
    let mut mountings: Vec<Mounting> = cameras.iter().map(RigidCamera::mounting).collect();
    for mounting in &mountings {
        mounting.place(model, &mounting.right_from_left);
    }
    adjust_mounted(model, options, &mut mountings)?;
    filter_all_points(model, filter);
    let summary = adjust_mounted(model, options, &mut mountings)?;
    make_frames(model, &mountings);
    for (camera, mounting) in cameras.iter_mut().zip(&mountings) {
        camera.right_from_left = mounting.right_from_left;
    }
    Ok(summary)
}

impl RigidCamera {
    fn mounting(&self) -> Mounting {
        let moment = |pair: &RigPair| Moment { right: pair.right, left: Left::At(pair.left) };
        Mounting {
            companion: Companion {
                left: self.left,
                right: self.right,
                clock: Clock::default(),
                timing: Timing::Together,
                unit: None,
                blind: None,
            },
            moments: self.pairs.iter().map(moment).collect(),
            right_from_left: self.right_from_left,
            hold: Hold::Rigid,
            closed: Vec::new(),
        }
    }
}
