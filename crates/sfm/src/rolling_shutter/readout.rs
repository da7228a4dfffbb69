use tiepoint_scene::CameraId;

/// Time from the first row of an image to the last one, in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Readout {
    /// As given, for every camera.
    Known(f64),
    /// Found, for each camera on its own.
    Estimated,
}

/// What the shutter of a camera does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RollingShutter {
    /// Which camera.
    pub camera: CameraId,
    /// Time from the first row to the last one, in seconds; negative where the last row comes
    /// first.
    pub readout_s: f64,
    /// Its standard deviation, where it was found; infinite where the images tell nothing.
    pub readout_sd_s: Option<f64>,
}
