#![doc = include_str!("../README.md")]

mod accept;
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

pub use brute::{Isa, NearestBothWays, nearest, nearest_on};
pub use error::Error;
pub use forest::{Checks, Forest, ForestOptions};
pub use guided::{EpipolarGuide, match_guided};
pub use matcher::{match_features, match_pairs, match_prepared, select};
pub use matches::{Match, Nearest};
pub use options::{Method, Options, PreemptiveMatching};
pub use pairs::{Ends, Pair, PairSelection, Sequence, listed_pairs};
pub use prepared::Prepared;
pub use retrieval::{GlobalDescriptor, RetrievalIndex, Similar, Vocabulary, VocabularyOptions};
pub use tiepoint_features as features;
