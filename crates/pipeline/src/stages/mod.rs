//! The stages of a run: features, matches, models, dense clouds.

pub(crate) mod calibration_priors;
mod colors;
pub(crate) mod dense;
pub(crate) mod extraction;
pub(crate) mod features;
pub(crate) mod foreign_database;
pub(crate) mod input_model;
pub(crate) mod mapping;
pub(crate) mod matching;
pub(crate) mod option_keys;
pub(crate) mod pair_choice;
pub(crate) mod positions;
pub(crate) mod reconstruct;
pub(crate) mod rig_calibration;
pub(crate) mod rig_hints;
pub(crate) mod scale;
pub(crate) mod stationary;
pub(crate) mod unregistered;
pub(crate) mod verification;
pub(crate) mod video;
pub(crate) mod warnings;

pub use colors::color_points;
pub use dense::dense;
pub use dense::options::DenseOptions;
pub use extraction::{extract_image, extract_photo, memory_of};
pub use features::{FeatureOptions, extract_features};
pub use foreign_database::{ImportedPairs, import_features};
pub use input_model::InputModel;
pub use mapping::{MapOptions, map, named_event};
pub use matching::{MatchOptions, match_images, match_pairs};
pub use pair_choice::{PairChoice, all_ids, choose_pairs, learn_retrieval};
pub use positions::PositionPriors;
pub use reconstruct::{Options, reconstruct};
pub use rig_calibration::known_rigs;
pub use stationary::Removal;
pub use video::{OpenedInput, open_input};
