#![doc = include_str!("../README.md")]

#[macro_use]
pub mod cameras;
mod error;
mod loss;
mod manifold;
mod rigid3;
mod rng;
mod sim3;
pub mod so3;
pub mod testing;

pub use cameras::{CameraModel, CameraModelKind, Intrinsics, Projection};
pub use error::Error;
pub use loss::Loss;
pub use manifold::{Block, Manifold};
pub use nalgebra;
pub use rigid3::Rigid3;
pub use rng::Rng;
pub use sim3::Sim3;
