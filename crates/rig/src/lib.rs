#![doc = include_str!("../README.md")]

mod average;
mod baseline;
mod clock;
mod clock_search;
mod interpolate;
mod mount;
mod mount_in_time;
pub mod paper;
mod relative_pose;
mod se3;
mod spread;
mod trajectory;

pub use average::robust_average;
pub use baseline::Baseline;
pub use clock::Clock;
pub use clock_search::{FoundOffset, find_offset};
pub use interpolate::Knots;
pub use mount::Mounted;
pub use mount_in_time::MountedInTime;
pub use relative_pose::RelativePose;
pub use se3::share_of;
pub use spread::{Spread, spread};
pub use tiepoint_ba as ba;
pub use tiepoint_geometry as geometry;
pub use trajectory::{Trajectory, interval_s, jitter_s};
