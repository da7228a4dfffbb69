//! Two-view geometry: verification of pairs, matches on overlays, focal lengths, and initial pairs.

mod agreement;
mod focal;
mod initial_pair;
mod stationary;
mod verify;

pub(crate) use agreement::{Agreement, agreement};
pub(crate) use focal::with_focal;
pub use focal::{estimate_focal_lengths, focal_priors};
pub use initial_pair::{InitialPair, initial_pairs};
pub(crate) use initial_pair::{estimate_relative_pose, relative_pose};
pub use stationary::{Candidates, MovedPairs, Overlay, Stationary, StationarySearch};
pub use verify::{ImageObservations, VerifyOptions, verify_pair};
