//! What is known beside the photos.

mod positions;
mod rig_calibration;
