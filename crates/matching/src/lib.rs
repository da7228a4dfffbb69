#![doc = include_str!("../README.md")]

mod accept;
mod auto_pairs;
mod brute;
mod compressed;
mod distance;
mod error;
mod forest;
mod guided;
mod matcher;
mod matches;
mod options;
mod packed;
mod pairs;
mod prepared;
mod pruned;
mod random;
mod retrieval;

pub use auto_pairs::{AutoPairs, CameraImages, SequenceOrder, auto_pairs, num_similar};
pub use brute::{Isa, NearestBothWays, nearest, nearest_on};
pub use error::Error;
pub use forest::{Checks, Forest, ForestOptions};
pub use guided::{EpipolarGuide, match_guided};
pub use matcher::{match_features, match_pairs, match_prepared, select};
pub use matches::{Match, Nearest};
pub use options::{Method, Options, PreemptiveMatching};
pub use pairs::{Pair, PairSelection, Sequence};
pub use prepared::Prepared;
pub use retrieval::{
    GlobalDescriptor, ImageWords, InvertedIndex, RetrievalIndex, Similar, Vocabulary,
    VocabularyOptions, VocabularyTree,
};
pub use tiepoint_features as features;
