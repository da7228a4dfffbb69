//! Relative transforms and their derivatives.

use nalgebra::{SMatrix, SVector};
use tiepoint_geometry::{Rigid3, Sim3};

use super::difference::Difference;

/// A transform `b_from_world` with a differentiable relative transform to another frame.
pub trait Relative<const N: usize>: Difference<N> {
    /// `b_from_a`, given `a_from_world`.
    fn relative_to(&self, a: &Self) -> Self;
    /// Derivatives of the tangent of `b_from_a` with respect to those of `a_from_world` and of
    /// `b_from_world`.
    fn d_relative(&self, b_from_a: &Self) -> [SMatrix<f64, N, N>; 2];
}

/// A motion of b is one of `b_from_a`. A motion of a moves `b_from_a` by its inverse, expressed in
/// b.
impl Relative<6> for Rigid3 {
    fn relative_to(&self, a: &Self) -> Self {
        *self * a.inverse()
    }
    fn d_relative(&self, b_from_a: &Self) -> [SMatrix<f64, 6, 6>; 2] {
        [-b_from_a.adjoint(), SMatrix::identity()]
    }
}

/// As for [`Rigid3`], with lengths of a scaled. Scaling frame b by e^σ about its own origin moves
/// the origin of a in b away from the origin of the world in b, which is the translation of
/// `b_from_world`. Scaling a moves it towards that point.
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
