#![doc = include_str!("../README.md")]

mod error;
pub mod undistort;

pub use error::Error;
pub use tiepoint_geometry as geometry;
pub use tiepoint_scene as scene;
