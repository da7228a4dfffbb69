use nalgebra::{SMatrix, SVector};
use tiepoint_geometry::{Block, Manifold, Rigid3};

use super::difference::{Difference, sqrt_information};
use super::relative::Relative;
use crate::error::Error;
use crate::factor::{Factor, Linear};

/// A measured relative pose of two frames, as in a pose graph. Variables: `a_from_world`,
/// `b_from_world`. Residual: A (`b_from_world · world_from_a` ⊟ `b_from_a`), rotation first. Six
/// numbers for rigid poses, seven for similarities, with the logarithm of the scale last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Between<V = Rigid3, const N: usize = 6> {
    /// The measured relative pose.
    pub b_from_a: V,
    /// A, where AᵀA is the inverse covariance of the tangent of `b_from_a`.
    pub sqrt_information: SMatrix<f64, N, N>,
}

impl<V: Difference<N>, const N: usize> Between<V, N> {
    /// `sigmas` are the standard deviations of the rotation (radians, about the axes of b), of the
    /// position of b's origin (along the axes of b), and of the other directions of the tangent.
    /// Infinite ones
    /// remove a direction.
    ///
    /// # Errors
    /// [`Error::Sigma`] for one that is not positive.
    pub fn new(b_from_a: V, sigmas: &[f64; N]) -> Result<Self, Error> {
        Ok(Self { b_from_a, sqrt_information: sqrt_information(sigmas)? })
    }
}

impl<V: Relative<N>, const N: usize> Factor<N> for Between<V, N> {
    type Vars = (V, V);

    fn linearize(&self, (a, b): (&V, &V)) -> Option<Linear<Self::Vars, N>> {
        let b_from_a = b.relative_to(a);
        let by_relative = self.sqrt_information * b_from_a.d_minus(&self.b_from_a);
        let [by_a, by_b] = b.d_relative(&b_from_a).map(|d_relative| {
            let mut jacobian = <V as Manifold>::Jacobian::<N>::zeros();
            jacobian.as_mut_slice().copy_from_slice((by_relative * d_relative).as_slice());
            jacobian
        });
        Some((self.sqrt_information * b_from_a.minus(&self.b_from_a), (by_a, by_b)))
    }

    fn residual(&self, (a, b): (&V, &V)) -> Option<SVector<f64, N>> {
        Some(self.sqrt_information * b.relative_to(a).minus(&self.b_from_a))
    }
}
