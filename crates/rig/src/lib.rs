#![doc = include_str!("../README.md")]

mod baseline;
mod clock;
mod clock_search;
mod interpolated_extrinsics;
mod knots;
pub mod paper;
mod relative_pose;
mod robust_average;
mod se3;
mod statistics;
mod synchronous_extrinsics;
mod trajectory;

pub use baseline::Baseline;
pub use clock::Clock;
pub use clock_search::{OffsetEstimate, find_offset, find_unrelated_offset};
pub use interpolated_extrinsics::InterpolatedExtrinsics;
pub use knots::Knots;
pub use relative_pose::RelativePose;
pub use robust_average::robust_average;
pub use se3::scaled_motion;
pub use statistics::{RelativePoseStatistics, relative_pose_statistics};
pub use synchronous_extrinsics::SynchronousExtrinsics;
pub use tiepoint_ba as ba;
pub use tiepoint_geometry as geometry;
pub use trajectory::{Trajectory, interval_s, timestamp_jitter_s};
