//! A finished model made rigid, whatever it was: each further camera with one calibration, exactly,
//! at every moment.
//!
//! The further cameras are moved to where the calibration has them; then everything is adjusted,
//! calibration, lenses and points included, with their poses being no variables at all.

use tiepoint_ba::Summary;
use tiepoint_geometry::Rigid3;
use tiepoint_rig::Clock;
use tiepoint_scene::{CameraId, Reconstruction};

use super::extrinsics::{RigConstraint, RigExtrinsics};
use super::extrinsics_term::adjust_with_extrinsics;
use super::frames::make_frames;
use super::pairs::RigPair;
use super::rig_sensor::{ClockState, ReferencePose, ReferencedImage, RigSensor};
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

/// Holds cameras exactly, adjusts the model, drops observations that no longer fit, and makes the
/// moments the model's frames.
pub fn constrain_rigidly(
    model: &mut Reconstruction,
    cameras: &mut [RigidCamera],
    options: &AdjustOptions,
    filter: &FilterOptions,
) -> Result<Summary, Error> {
    model.frames.clear();
    model.rigs.clear();
    let mut all_extrinsics: Vec<RigExtrinsics> =
        cameras.iter().map(RigidCamera::extrinsics).collect();
    for extrinsics in &all_extrinsics {
        extrinsics.place(model, &extrinsics.right_from_left);
    }
    adjust_with_extrinsics(model, options, &mut all_extrinsics)?;
    filter_all_points(model, filter);
    let summary = adjust_with_extrinsics(model, options, &mut all_extrinsics)?;
    make_frames(model, &all_extrinsics);
    for (camera, extrinsics) in cameras.iter_mut().zip(&all_extrinsics) {
        camera.right_from_left = extrinsics.right_from_left;
    }
    Ok(summary)
}

impl RigidCamera {
    fn extrinsics(&self) -> RigExtrinsics {
        let referenced = |pair: &RigPair| ReferencedImage {
            right: pair.right,
            reference: ReferencePose::Synchronous(pair.left),
        };
        RigExtrinsics {
            rig_sensor: RigSensor {
                left: self.left,
                right: self.right,
                clock: Clock::default(),
                clock_state: ClockState::Synchronised,
                assumed_baseline: None,
                unobservable_direction: None,
            },
            referenced_images: self.pairs.iter().map(referenced).collect(),
            right_from_left: self.right_from_left,
            constraint: RigConstraint::Rigid,
            closed: Vec::new(),
        }
    }
}
