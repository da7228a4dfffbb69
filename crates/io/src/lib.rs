#![doc = include_str!("../README.md")]

mod atomic;
mod binary;
pub mod colmap;
#[cfg(feature = "database")]
pub mod database;
mod error;
mod exif;
mod images;
mod jpeg;
mod pixels;
mod text;
pub mod timestamps;

pub use atomic::AtomicFile;
pub use error::{Error, Result};
pub use exif::Exif;
pub use images::{IMAGE_EXTENSIONS, ImageFolder, ImageInfo, ImageSource, SourceImage};
pub use pixels::{Luma, Rgb};
pub use tiepoint_features as features;
pub use tiepoint_scene as scene;
