#![doc = include_str!("../README.md")]

mod cloud;
mod coarse;
mod poses;
mod relative;
mod rig;
mod statistics;
mod surface;
mod trajectory;

pub use cloud::{Cloud, CloudAlignment, IcpOptions};
pub use coarse::find_alignment;
pub use poses::{Alignment, PoseComparison, compare_poses, focal_error};
pub use relative::{auc, relative_pose_errors_rad};
pub use rig::{PosePair, RigOverTime, rig_over_time};
pub use statistics::Statistics;
pub use surface::{Sighting, SurfaceError, points_of_true_cameras, surface_errors};
pub use tiepoint_geometry as geometry;
pub use trajectory::{
    MotionError, associate, consecutive_pairs_by_path, pairs_by_frames, pairs_by_path,
    relative_motion_errors,
};
