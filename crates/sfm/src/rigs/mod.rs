//! Rig calibration: image association across cameras, estimation of extrinsics and clock offsets,
//! and constraints on relative poses.

mod autocorrelation_time;
mod candidates;
mod constrain;
mod context;
mod covariance;
mod each_camera;
mod extrinsics;
mod extrinsics_term;
mod frames;
mod frames_by_time;
mod gating;
mod held_out;
mod merge_by_motion;
mod pairs;
mod paper;
mod rematch;
mod rigid;
mod saved;
mod sensor_pair;
mod sigma_selection;
mod soft_rig;
mod solution;
mod succession;

pub use candidates::rig_candidates;
pub(crate) use constrain::constrain_rig;
pub(crate) use context::{Context, HeldIntrinsics};
pub use extrinsics::{ExtrinsicsCovariance, RigConstraint};
pub use frames_by_time::frames_by_time;
pub use held_out::HeldOutChange;
pub(crate) use merge_by_motion::merge_by_motion;
pub use pairs::{RigPair, RigPairs, relative_poses, rig_pairs};
pub use paper::{BaselineLink, BaselineTerm, LinkWeights, final_links, growing_links};
pub use rematch::Descriptors;
pub use rigid::{RigidCamera, constrain_rigidly};
pub use sensor_pair::{
    ClockState, ReferencePose, ReferencedImage, SensorPair, have_numbered_frames, sensor_pairs,
};
pub use soft_rig::SoftRig;
pub use solution::{CalibratedCamera, CalibratedRig, ConstraintLimit, SplitRepair};
pub use succession::successive_cameras;

pub use crate::timeline::NUMBERED_FRAME_S;
