#![doc = include_str!("../README.md")]

mod atomic;
mod binary;
pub mod colmap;
#[cfg(feature = "database")]
pub mod database;
mod error;
mod text;

pub use atomic::AtomicFile;
pub use error::{Error, Result};
pub use tiepoint_features as features;
pub use tiepoint_scene as scene;
