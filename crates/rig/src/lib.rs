#![doc = include_str!("../README.md")]

mod average;
mod baseline;
mod clock;
mod clock_search;
mod interpolate;
mod interpolated_extrinsics;
pub mod paper;
mod relative_pose;
mod se3;
mod statistics;
mod synchronous_extrinsics;
mod trajectory;

pub use average::robust_average;
pub use baseline::Baseline;
pub use clock::Clock;
pub use clock_search::{FoundOffset, find_offset};
pub use interpolate::Knots;
pub use interpolated_extrinsics::InterpolatedExtrinsics;
pub use relative_pose::RelativePose;
pub use se3::scaled_motion;
pub use statistics::{RelativePoseStatistics, relative_pose_statistics};
pub use synchronous_extrinsics::SynchronousExtrinsics;
pub use tiepoint_ba as ba;
pub use tiepoint_geometry as geometry;
pub use trajectory::{Trajectory, interval_s, timestamp_jitter_s};
