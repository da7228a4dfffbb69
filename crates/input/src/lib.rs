#![doc = include_str!("../README.md")]

pub mod cameras;
mod error;
pub mod fingerprint;
pub mod images;
pub mod parallel;
pub mod sequences;
pub mod video;

pub use cameras::{Calibration, CalibrationSource, CameraGrouping, Photos, SkippedImage};
pub use error::{Error, Size};
pub use images::{
    ABSOLUTE_MAX_PIXELS, DEFAULT_MAX_PIXELS, Exif, ImageFolder, ImageInfo, Luma, Rgb,
};
