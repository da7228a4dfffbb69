#![doc = include_str!("../README.md")]

mod atomic;
pub mod bal;
mod binary;
pub mod calibration;
pub mod colmap;
pub mod control_points;
mod counted_file;
#[cfg(feature = "database")]
pub mod database;
pub mod dense;
mod error;
pub mod geo_path;
pub mod gltf;
pub mod gpx;
pub mod gsplat;
pub mod kitti;
#[cfg(feature = "las")]
pub mod las;
pub mod names;
pub mod nerfstudio;
pub mod openmvs;
pub mod ply;
pub mod position_priors;
pub mod positions;
pub mod rig_calibration;
mod rotation;
pub mod similarity;
pub mod strecha;
mod text;
pub mod timestamps;
pub mod trajectory;
mod yaml;

pub use error::{Error, Result};
pub use text::read_text;
pub use tiepoint_features as features;
pub use tiepoint_scene as scene;
pub use tiepoint_store as store;
