//! Registration: which image is next, and where it is.

mod continuity;
mod next_image;
mod place;
mod visibility;

pub(crate) use next_image::NextBestView;
pub use place::{RegisterOptions, register_image};
