//! Registration: selection of the next image, and estimation of its pose.

mod continuity;
mod next_image;
mod place;
mod visibility;

pub(crate) use next_image::NextBestView;
pub use place::{RegisterOptions, register_image};
