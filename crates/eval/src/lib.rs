#![doc = include_str!("../README.md")]

mod cloud;
mod coarse_alignment;
mod poses;
mod relative_pose_errors;
mod relative_pose_statistics;
mod statistics;
mod surface;
mod trajectory;

pub use cloud::{Cloud, CloudAlignment, IcpOptions};
pub use coarse_alignment::find_alignment;
pub use poses::{Alignment, PoseComparison, compare_poses, focal_error};
pub use relative_pose_errors::{auc, relative_pose_errors_rad};
pub use relative_pose_statistics::{PosePair, RelativePoseSeries, relative_pose_series};
pub use statistics::Statistics;
pub use surface::{SurfaceError, TrueObservation, surface_errors, triangulate_true_observations};
pub use tiepoint_geometry as geometry;
pub use trajectory::{
    MotionError, associate, consecutive_pairs_by_path, pairs_by_frames, pairs_by_path,
    relative_motion_errors,
};
