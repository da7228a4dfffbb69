//! What is known beside the photos.

mod control_points;
mod positions;
mod rig_calibration;
