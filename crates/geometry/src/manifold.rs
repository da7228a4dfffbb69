//! Manifolds: values that an optimiser perturbs by vectors of a tangent space. CONVENTIONS.md gives
//! the side of each perturbation.

use std::fmt::Debug;

use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector1};

use crate::so3;

/// A fixed-size column-major matrix of `f64` that can be read as a slice.
pub trait Block: Copy + Debug + PartialEq + Send + Sync + 'static {
    /// The zero matrix.
    fn zeros() -> Self;
    /// The entries, column by column.
    fn as_slice(&self) -> &[f64];
    /// The entries, column by column.
    fn as_mut_slice(&mut self) -> &mut [f64];
}

impl<const R: usize, const C: usize> Block for SMatrix<f64, R, C> {
    fn zeros() -> Self {
        SMatrix::zeros()
    }
    fn as_slice(&self) -> &[f64] {
        self.as_slice()
    }
    fn as_mut_slice(&mut self) -> &mut [f64] {
        self.as_mut_slice()
    }
}

/// A manifold of `DOF` dimensions (Ceres: `Manifold`).
///
/// Invariants, which `testing::manifold_laws` checks: `x.plus(0) == x`, `x.plus(y.minus(x)) == y`,
/// and `x.plus(d).minus(x) == d` for small `d`.
pub trait Manifold: Copy + Debug + PartialEq + Send + Sync + 'static {
    /// Dimension of the tangent space.
    const DOF: usize;
    /// A tangent vector: `SVector<f64, DOF>`.
    type Tangent: Block;
    /// The Jacobian of `R` residuals: `SMatrix<f64, R, DOF>`.
    type Jacobian<const R: usize>: Block;
    /// The value perturbed by a tangent vector (retraction).
    fn plus(&self, delta: &Self::Tangent) -> Self;
    /// The tangent vector `d` at `base` with `base.plus(d) == self`.
    fn minus(&self, base: &Self) -> Self::Tangent;
}

impl<const N: usize> Manifold for SVector<f64, N> {
    const DOF: usize = N;
    type Tangent = SVector<f64, N>;
    type Jacobian<const R: usize> = SMatrix<f64, R, N>;
    fn plus(&self, delta: &Self::Tangent) -> Self {
        self + delta
    }
    fn minus(&self, base: &Self) -> Self::Tangent {
        self - base
    }
}

impl Manifold for f64 {
    const DOF: usize = 1;
    type Tangent = Vector1<f64>;
    type Jacobian<const R: usize> = SMatrix<f64, R, 1>;
    fn plus(&self, delta: &Self::Tangent) -> Self {
        self + delta.x
    }
    fn minus(&self, base: &Self) -> Self::Tangent {
        Vector1::new(self - base)
    }
}

/// Rotations, perturbed on the left: R ← Exp(δ) R.
impl Manifold for UnitQuaternion<f64> {
    const DOF: usize = 3;
    type Tangent = SVector<f64, 3>;
    type Jacobian<const R: usize> = SMatrix<f64, R, 3>;
    fn plus(&self, delta: &Self::Tangent) -> Self {
        so3::exp(delta) * self
    }
    fn minus(&self, base: &Self) -> Self::Tangent {
        so3::log(&(self * base.inverse()))
    }
}
