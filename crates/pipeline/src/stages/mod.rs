//! The stages of a run: features, matches, models, dense clouds.

pub(crate) mod colors;
pub(crate) mod dense;
pub(crate) mod extractors;
pub(crate) mod features;
pub(crate) mod foreign_database;
pub(crate) mod input_model;
pub(crate) mod loaded_features;
pub(crate) mod mapping;
pub(crate) mod matching;
pub(crate) mod option_keys;
pub(crate) mod pair_choice;
pub(crate) mod reconstruct;
pub(crate) mod rig_calibration;
pub(crate) mod rig_hints;
pub(crate) mod scale;
pub(crate) mod video;
