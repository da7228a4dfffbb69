use nalgebra::Vector3;

use crate::{Rigid3, so3};

/// Motion of a rolling-shutter camera during the exposure of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowPoses {
    /// Velocity of the camera centre in the world frame, in units of the model a second.
    pub velocity_in_world: Vector3<f64>,
    /// Angular velocity in the camera frame, in radians a second.
    pub angular_velocity_rad_s: Vector3<f64>,
    /// Time from the first row to the last one, in seconds.
    pub readout_s: f64,
    /// Height of the image, in pixels.
    pub height_px: f64,
}

impl RowPoses {
    /// Returns the pose at the exposure of the row `y_px`, given the pose of the image, which is
    /// that of the middle row.
    pub fn cam_from_world(&self, middle: &Rigid3, y_px: f64) -> Rigid3 {
        let time_s = (y_px / self.height_px - 0.5) * self.readout_s;
        let shift = middle.rotation * self.velocity_in_world * time_s;
        let turn = so3::exp(&(self.angular_velocity_rad_s * time_s));
        Rigid3::new(turn * middle.rotation, turn * (middle.translation - shift))
    }
}
