#![doc = include_str!("../README.md")]

mod error;
pub mod fusion;
mod grey;
mod ncc;
mod pinhole;
mod plane;
mod rows;
pub mod stereo;
mod transfer;
pub mod undistort;
mod view_selection;

pub use error::Error;
pub use grey::Grey;
pub use pinhole::PosedPinhole;
pub use rows::PixelPoses;
pub use tiepoint_geometry as geometry;
pub use tiepoint_scene as scene;
pub use view_selection::{StereoProblem, neighbours, select_views};
