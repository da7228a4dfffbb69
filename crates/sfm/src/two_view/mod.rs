//! Two-view geometry: verification of pairs, focal lengths, and initial pairs.

mod focal;
mod initial_pair;
mod verify;

pub(crate) use focal::with_focal;
pub use focal::{estimate_focal_lengths, focal_priors};
pub use initial_pair::{InitialPair, initial_pairs};
pub(crate) use initial_pair::{estimate_relative_pose, relative_pose};
pub use verify::{ImageObservations, VerifyOptions, verify_pair};
