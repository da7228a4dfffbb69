//! Cameras on a rig: which images belong together, and how the cameras are held to each other.

mod autocorrelation_time;
mod constrain;
mod context;
mod covariance;
mod extrinsics;
mod extrinsics_term;
mod frames;
mod held_out;
mod join;
mod members;
mod pairs;
mod paper;
mod rematch;
mod rig_sensor;
mod rigid;
mod sigma_selection;
mod solution;

pub(crate) use constrain::constrain_rig;
pub(crate) use context::Context;
pub use extrinsics::{ExtrinsicsCovariance, RigConstraint};
pub(crate) use join::joined;
pub use pairs::{RigPair, RigPairs, relative_poses, rig_pairs};
pub use paper::{BaselineLink, BaselineTerm, final_links, growing_links};
pub use rematch::Descriptors;
pub use rig_sensor::{ClockState, ReferencePose, ReferencedImage, RigSensor, rig_sensors};
pub use rigid::{RigidCamera, constrain_rigidly};
pub use solution::{CalibratedCamera, CalibratedRig, ClosedSplit};
