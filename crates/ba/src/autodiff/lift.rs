//! Variables over dual numbers: x ⊞ ε, exact to first order.

use nalgebra::{SVector, UnitQuaternion};
use tiepoint_geometry::{Block, Manifold, Rigid3};

use super::Scalar;
use crate::factor::{Refs, Vars};

/// A variable that can be lifted to dual numbers.
pub trait Lift: Manifold {
    /// The variable with components of type `T`.
    type Of<T: Scalar>;
    /// x ⊞ `tangent`, whose value part is zero.
    fn lift<T: Scalar>(&self, tangent: &[T]) -> Self::Of<T>;
}

impl<const N: usize> Lift for SVector<f64, N> {
    type Of<T: Scalar> = [T; N];
    #[inline]
    fn lift<T: Scalar>(&self, tangent: &[T]) -> [T; N] {
        std::array::from_fn(|i| tangent[i] + self[i])
    }
}

impl Lift for f64 {
    type Of<T: Scalar> = T;
    #[inline]
    fn lift<T: Scalar>(&self, tangent: &[T]) -> T {
        tangent[0] + *self
    }
}

/// A rotation matrix, row by row: Exp(ε) R ≈ R + ε × R.
impl Lift for UnitQuaternion<f64> {
    type Of<T: Scalar> = [[T; 3]; 3];
    #[inline]
    fn lift<T: Scalar>(&self, w: &[T]) -> [[T; 3]; 3] {
        let m = self.to_rotation_matrix();
        std::array::from_fn(|i| {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            std::array::from_fn(|c| w[j] * m[(k, c)] - w[k] * m[(j, c)] + m[(i, c)])
        })
    }
}

/// A [`Rigid3`] with components of type `T`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidOf<T> {
    /// Rotation matrix of b from a, row by row.
    pub rotation: [[T; 3]; 3],
    /// Origin of a in b.
    pub translation: [T; 3],
}

impl<T: Scalar> RigidOf<T> {
    /// `point_in_b` of `point_in_a`.
    #[inline]
    pub fn transform(&self, point_in_a: &[T; 3]) -> [T; 3] {
        let [x, y, z] = *point_in_a;
        std::array::from_fn(|i| {
            let row = &self.rotation[i];
            row[0] * x + row[1] * y + row[2] * z + self.translation[i]
        })
    }
}

/// Exp(ε) t + τ ≈ t + ε × t + τ.
impl Lift for Rigid3 {
    type Of<T: Scalar> = RigidOf<T>;
    #[inline]
    fn lift<T: Scalar>(&self, tangent: &[T]) -> RigidOf<T> {
        let (w, t) = (&tangent[..3], &self.translation);
        let translation = std::array::from_fn(|i| {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            w[j] * t[k] - w[k] * t[j] + tangent[3 + i] + t[i]
        });
        RigidOf { rotation: self.rotation.lift(tangent), translation }
    }
}

/// A tuple of one to eight variables that can be lifted.
pub trait LiftVars: Vars {
    /// The tuple with components of type `T`.
    type Of<T: Scalar>;
    /// All variables moved by their parts of the tangent.
    #[doc(hidden)]
    fn lift<T: Scalar>(x: Refs<'_, Self>, tangent: &[T]) -> Self::Of<T>;
    /// Jacobian blocks from the columns of all variables.
    #[doc(hidden)]
    fn jacobians<const R: usize>(columns: &[[f64; R]]) -> Self::Jacobians<R>;
}

macro_rules! impl_lift_vars {
    ($($V:ident $i:tt),*) => {
        impl<$($V: Lift),*> LiftVars for ($($V,)*) {
            type Of<T: Scalar> = ($($V::Of<T>,)*);
            #[inline]
            fn lift<T: Scalar>(x: Refs<'_, Self>, tangent: &[T]) -> Self::Of<T> {
                let mut rest = tangent;
                ($({
                    let (these, others) = rest.split_at($V::DOF);
                    rest = others;
                    let _ = rest;
                    x.$i.lift(these)
                },)*)
            }
            #[inline]
            fn jacobians<const R: usize>(columns: &[[f64; R]]) -> Self::Jacobians<R> {
                let mut rest = columns;
                ($({
                    let (these, others) = rest.split_at($V::DOF);
                    rest = others;
                    let _ = rest;
                    let mut block = <$V::Jacobian<R> as Block>::zeros();
                    block.as_mut_slice().copy_from_slice(these.as_flattened());
                    block
                },)*)
            }
        }
    };
}

impl_lift_vars!(A 0);
impl_lift_vars!(A 0, B 1);
impl_lift_vars!(A 0, B 1, C 2);
impl_lift_vars!(A 0, B 1, C 2, D 3);
impl_lift_vars!(A 0, B 1, C 2, D 3, E 4);
impl_lift_vars!(A 0, B 1, C 2, D 3, E 4, F 5);
impl_lift_vars!(A 0, B 1, C 2, D 3, E 4, F 5, G 6);
impl_lift_vars!(A 0, B 1, C 2, D 3, E 4, F 5, G 6, H 7);
