//! Rolling shutters: how long the rows of an image take, and what that does to its keypoints.

mod motion;
mod readout;
mod shutters;
mod term;

pub use motion::RowPoses;
pub(crate) use motion::row_poses;
pub use readout::{Readout, RollingShutter};
pub(crate) use shutters::RollingShutters;
