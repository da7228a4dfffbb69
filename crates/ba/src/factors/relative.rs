//! Derivatives of one frame as seen from another.

use nalgebra::{SMatrix, SVector};
use tiepoint_geometry::{Rigid3, Sim3};

use super::difference::Difference;

/// A transform `b_from_world`, of which the one of another frame can be taken off.
pub trait Relative<const N: usize>: Difference<N> {
    /// `b_from_a`, of `a_from_world`.
    fn relative_to(&self, a: &Self) -> Self;
    /// The tangent of that `b_from_a` by those of `a_from_world` and of `b_from_world`.
    fn d_relative(&self, b_from_a: &Self) -> [SMatrix<f64, N, N>; 2];
}

/// A motion of b is one of `b_from_a`, and one of a moves it by its opposite, seen in b.
impl Relative<6> for Rigid3 {
    fn relative_to(&self, a: &Self) -> Self {
        *self * a.inverse()
    }
    fn d_relative(&self, b_from_a: &Self) -> [SMatrix<f64, 6, 6>; 2] {
        [-b_from_a.adjoint(), SMatrix::identity()]
    }
}

/// As for [`Rigid3`], with lengths of a scaled. When a frame grows by e^σ about its own origin, the
/// origin of a moves in b away from that of the world (or towards it, when a grows), which
/// `b_from_world` shows as its translation.
impl Relative<7> for Sim3 {
    fn relative_to(&self, a: &Self) -> Self {
        *self * a.inverse()
    }
    fn d_relative(&self, b_from_a: &Self) -> [SMatrix<f64, 7, 7>; 2] {
        let mut by_scale = SVector::<f64, 7>::zeros();
        by_scale.fixed_rows_mut::<3>(3).copy_from(&(b_from_a.translation - self.translation));
        by_scale[6] = 1.0;
        let mut by_a = SMatrix::<f64, 7, 7>::zeros();
        by_a.fixed_view_mut::<6, 6>(0, 0).copy_from(&-b_from_a.without_scale().adjoint());
        let mut lengths = by_a.fixed_view_mut::<3, 3>(3, 3);
        lengths *= b_from_a.scale;
        by_a.set_column(6, &-by_scale);
        let mut by_b = SMatrix::<f64, 7, 7>::identity();
        by_b.set_column(6, &by_scale);
        [by_a, by_b]
    }
}
