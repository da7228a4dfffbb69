//! Fusion of depth maps into one cloud, image by image, with a bounded number of images in memory.

mod cache;
mod fuse;
mod image;
mod options;

pub use fuse::{FusedPoint, MAX_NEIGHBOURS, fuse};
pub use image::FusionImage;
pub use options::FusionOptions;
