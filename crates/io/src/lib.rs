#![doc = include_str!("../README.md")]

mod atomic;
pub mod bal;
mod binary;
pub mod calibration;
pub mod colmap;
mod counted_file;
#[cfg(feature = "database")]
pub mod database;
mod dense_map;
mod depth_scale;
mod error;
mod excerpt;
mod exif;
mod fused_ply;
mod fused_visibility;
pub mod gltf;
mod gopro;
pub mod gsplat;
mod images;
mod jpeg;
pub mod kitti;
#[cfg(feature = "las")]
pub mod las;
pub mod nerfstudio;
pub mod openmvs;
mod pixels;
pub mod ply;
pub mod positions;
mod reduce;
pub mod rig_calibration;
mod rotation;
pub mod similarity;
pub mod strecha;
mod text;
pub mod timestamps;
mod tone_map;
pub mod trajectory;
pub mod video;
mod yaml;

pub use dense_map::DenseMap;
pub use depth_scale::DepthScale;
pub use error::{Error, Result};
pub use exif::{Device, Exif, is_plausible_focal};
pub use fused_ply::FusedPly;
pub use fused_visibility::FusedVisibility;
pub use images::{ImageFolder, ImageInfo, SkippedFile, SourceImage, is_image, is_unread_image};
pub use pixels::{ABSOLUTE_MAX_PIXELS, DEFAULT_MAX_PIXELS, Luma, Rgb};
pub use text::read_text;
pub use tiepoint_features as features;
pub use tiepoint_scene as scene;
pub use tiepoint_store as store;
