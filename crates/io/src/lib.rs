#![doc = include_str!("../README.md")]

mod atomic;
pub mod bal;
mod binary;
pub mod colmap;
#[cfg(feature = "database")]
pub mod database;
mod error;
mod exif;
mod gopro;
mod images;
mod jpeg;
pub mod kitti;
#[cfg(feature = "las")]
pub mod las;
pub mod nerfstudio;
pub mod openmvs;
mod pixels;
pub mod ply;
mod rotation;
pub mod strecha;
mod text;
pub mod timestamps;
pub mod trajectory;
pub mod undistort;
pub mod video;

pub use atomic::AtomicFile;
pub use error::{Error, Result};
pub use exif::Exif;
pub use images::{ImageFolder, ImageInfo, ImageSource, SourceImage, is_image};
pub use pixels::{Luma, Rgb};
pub use tiepoint_features as features;
pub use tiepoint_scene as scene;
