#![doc = include_str!("../README.md")]

mod simd;
#[macro_use]
pub mod cameras;
pub mod crs;
pub mod epipolar;
mod error;
pub mod estimate;
pub mod geodesy;
mod loss;
mod manifold;
pub mod numeric;
mod option_error;
mod ransac;
mod rigid3;
mod row_poses;
mod sim3;
mod small_lm;
pub mod so3;
pub mod solvers;
pub mod testing;
pub mod triangulate;

pub use cameras::{CameraModel, CameraModelKind, Intrinsics, Projection};
pub use error::Error;
pub use loss::Loss;
pub use manifold::{Block, Manifold};
pub use nalgebra;
pub use option_error::OptionError;
pub use ransac::{Estimator, RansacOptions, Report, ransac};
pub use rigid3::Rigid3;
pub use row_poses::RowPoses;
pub use sim3::Sim3;
pub use tiepoint_simd::Rng;
