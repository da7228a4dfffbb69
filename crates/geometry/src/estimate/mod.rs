//! Robust estimation of poses and two-view geometry: one RANSAC estimator with nonlinear
//! refinement for each problem. See [`ransac`](crate::ransac()).

mod absolute_pose;
mod absolute_pose_focal;
mod fundamental;
mod generalized_absolute_pose;
mod homography;
mod relative_pose;
mod robust_weights;
mod sampson;
mod similarity;

pub use absolute_pose::{absolute_pose, refine_absolute_pose};
pub use absolute_pose_focal::absolute_pose_focal;
pub use fundamental::fundamental;
pub use generalized_absolute_pose::{RigCamera, RigObservation, generalized_absolute_pose};
pub use homography::homography;
pub use relative_pose::{essential, relative_pose};
pub use similarity::similarity;
