//! A camera's clock against the first camera's.

use tiepoint_ba::factors::Difference;
use tiepoint_geometry::Manifold;
use tiepoint_geometry::nalgebra::{Matrix2, Vector2};

/// What turns a camera's times into those of the first camera: time + offset + drift · (time −
/// pivot). A variable of two dimensions: offset and drift.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Clock {
    /// What to add, at the pivot, in seconds.
    pub offset_s: f64,
    /// How much more to add with each second.
    pub drift: f64,
    /// Where the offset is that, on this clock: the middle of the drive, so that offset and drift
    /// tell apart.
    pub pivot_s: f64,
}

impl Clock {
    /// The first camera's time when this one shows `time_s`.
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
