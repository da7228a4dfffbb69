use tiepoint_scene::CameraId;

use crate::saved::saved;

/// Readout time: time from the first row of an image to the last one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Readout {
    /// The given time in seconds, for every camera.
    Known(f64),
    /// Estimated for each camera.
    Estimated,
}

/// Rolling shutter of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RollingShutter {
    /// The camera.
    pub camera: CameraId,
    /// Readout time in seconds; negative if the last row is exposed first.
    pub readout_s: f64,
    /// Standard deviation in seconds, if estimated; infinite if the images do not determine it.
    pub readout_sd_s: Option<f64>,
}

saved! { struct RollingShutter { camera, readout_s, readout_sd_s } }
