//! A sample of a motion, from which poses between samples are interpolated.

/// Time between samples, in seconds.
pub(super) const STEP_S: f64 = 1e-3;

/// The pose of the carrier at a step (metres, radians).
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// x, y, yaw, pitch, roll and height.
    pub(super) pose: [f64; 6],
    /// Their rates, per second.
    pub(super) rates: [f64; 6],
    /// Distance travelled since the beginning.
    pub(super) travelled_m: f64,
}
