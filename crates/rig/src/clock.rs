//! Clock model of a camera relative to the reference camera.

use tiepoint_ba::factors::Difference;
use tiepoint_geometry::Manifold;
use tiepoint_geometry::nalgebra::{Matrix2, Vector2};

/// Maps times of a camera to times of the reference camera: time + offset + drift · (time − pivot).
/// A variable of two dimensions, offset and drift (skew).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Clock {
    /// Offset to add at the pivot, in seconds.
    pub offset_s: f64,
    /// Skew: additional offset per second.
    pub drift: f64,
    /// Time on this camera's clock at which the offset applies. The middle of the drive
    /// decorrelates offset and drift.
    pub pivot_s: f64,
}

impl Clock {
    /// Time of the reference camera when this camera's clock shows `time_s`, both in seconds.
    pub fn reference_time_s(&self, time_s: f64) -> f64 {
        time_s + self.offset_s + self.drift * (time_s - self.pivot_s)
    }
}

impl Manifold for Clock {
    const DOF: usize = 2;
    type Tangent = Vector2<f64>;
    type Jacobian<const R: usize> = tiepoint_geometry::nalgebra::SMatrix<f64, R, 2>;
    fn plus(&self, delta: &Vector2<f64>) -> Self {
        Self { offset_s: self.offset_s + delta.x, drift: self.drift + delta.y, ..*self }
    }
    fn minus(&self, base: &Self) -> Vector2<f64> {
        Vector2::new(self.offset_s - base.offset_s, self.drift - base.drift)
    }
}

impl Difference<2> for Clock {
    fn d_minus(&self, _: &Self) -> Matrix2<f64> {
        Matrix2::identity()
    }
}
