//! The photos of a run, which of them share a camera, and what is known of the cameras.

mod calibration;
mod facts;
mod found;
mod grouping;
mod known_intrinsics;
mod photos;

pub use calibration::{CalibrationSource, Calibrations, camera_of_photo, is_named};
pub use facts::{CalibrationFacts, FOUND};
pub use found::{Calibration, FoundCameras, firsts};
pub use grouping::CameraGrouping;
pub use photos::{Photo, Photos, SkippedImage};
