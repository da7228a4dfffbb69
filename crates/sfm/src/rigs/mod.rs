//! Cameras on a rig: which images belong together, and how the cameras are held to each other.

mod companion;
mod context;
mod covariance;
mod frames;
mod hold;
mod join;
mod judge;
mod members;
mod mounting;
mod mounting_term;
mod pairs;
mod paper;
mod persistence;
mod rematch;
mod rigid;
mod solution;
mod tighten;

pub use companion::{Companion, Left, Moment, Timing, companions};
pub(crate) use context::Context;
pub(crate) use hold::hold_to_mountings;
pub(crate) use join::joined;
pub use mounting::{Hold, MountingCovariance};
pub use pairs::{RigPair, RigPairs, relative_poses, rig_pairs};
pub use paper::{BaselineLink, BaselineTerm, final_links, growing_links};
pub use rematch::Descriptors;
pub use rigid::{RigidCamera, hold_rigidly};
pub use solution::{ClosedSplit, MountedCamera, MountedRig};
