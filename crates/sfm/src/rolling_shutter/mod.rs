//! Rolling shutters: estimation of readout times, and correction of keypoints.

mod motion;
mod readout;
mod shutters;
mod term;

pub use motion::row_poses;
pub use readout::{Readout, RollingShutter};
pub(crate) use shutters::RollingShutters;
