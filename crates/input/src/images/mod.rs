//! Folders of images: names, pixels, EXIF data.
//!
//! The functions return the error of `tiepoint_io`: it is about files.

mod depth_scale;
mod exif;
mod folder;
mod folder_names;
mod jpeg;
mod masks;
mod pixels;
mod place;
mod reduce;
mod skipped;
mod tiff_pages;

pub use depth_scale::DepthScale;
pub(crate) use exif::seconds_of_date;
pub use exif::{Device, Exif, is_plausible_focal};
pub use folder::{ImageFolder, ImageInfo, SourceImage, is_image, is_unread_image};
pub(crate) use folder::{VIDEO_EXTENSIONS, first_names, has_extension};
pub(crate) use pixels::SizeLimit;
pub use pixels::{ABSOLUTE_MAX_PIXELS, DEFAULT_MAX_PIXELS, Luma, Rgb};
pub use skipped::SkippedFile;
