#![doc = include_str!("../README.md")]

mod accept;
mod any_kind;
mod auto_pairs;
mod brute;
mod compressed;
mod distance;
mod error;
pub mod forest;
mod guided;
mod match_sift;
mod matcher;
mod matches;
mod nearest_neighbours;
mod options;
mod packed;
mod pairs;
mod prepared;
mod pruned;
mod random;
pub mod retrieval;

pub use auto_pairs::{
    AutoPairs, CameraImages, SequenceOrder, auto_pairs, may_be_recordings, num_similar,
};
pub use error::Error;
pub use guided::{EpipolarGuide, match_guided};
pub use matcher::{Matcher, PreparedImages};
pub use matches::Match;
pub use nearest_neighbours::{NearestNeighbours, match_features};
pub use options::{Method, Options, PreemptiveMatching};
pub use pairs::{Pair, PairSelection, Sequence};
pub use tiepoint_features as features;

/// The kernels for SIFT descriptors.
pub mod sift {
    pub use crate::brute::{Isa, NearestBothWays, nearest, nearest_on};
    pub use crate::match_sift::{match_prepared, match_prepared_on, select};
    pub use crate::matches::Nearest;
    pub use crate::prepared::Prepared;
}
