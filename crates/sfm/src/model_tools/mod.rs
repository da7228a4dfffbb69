//! Work on finished models: crop one, align one to another, merge several.

mod align;
mod crop;
mod merge;

pub use align::{ModelAlignment, align_models};
pub use crop::{BoundingBox, crop};
pub use merge::{MergeOutcome, merge_model};
