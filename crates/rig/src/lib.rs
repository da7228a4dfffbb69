#![doc = include_str!("../README.md")]

mod average;
mod baseline;
mod mount;
pub mod paper;
mod relative_pose;
mod spread;

pub use average::robust_average;
pub use baseline::Baseline;
pub use mount::Mounted;
pub use relative_pose::RelativePose;
pub use spread::{Spread, spread};
pub use tiepoint_ba as ba;
pub use tiepoint_geometry as geometry;
