//! Work on finished models: crop one, align one to another, merge several,
//! transfer one to a scene of the same images.

mod align;
mod crop;
mod merge;
mod transfer;

pub use align::{ModelAlignment, align_models};
pub use crop::{BoundingBox, crop};
pub(crate) use merge::merge_aligned;
pub use merge::{MergeOutcome, merge_model};
pub use transfer::{Transferred, transfer_model};
