use nalgebra::{SMatrix, SVector};
use tiepoint_geometry::{Block, Manifold};

use super::difference::{Difference, sqrt_information};
use crate::error::Error;
use crate::factor::{Factor, Linear};

/// A prior on the value of a variable. Residual: A (x ⊟ mean), with A the square root of the
/// information matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior<V, const N: usize> {
    /// The mean.
    pub mean: V,
    /// A, where AᵀA is the inverse covariance of the tangent.
    pub sqrt_information: SMatrix<f64, N, N>,
}

impl<V: Difference<N>, const N: usize> Prior<V, N> {
    /// From a standard deviation for each tangent direction. An infinite one removes the direction.
    ///
    /// # Errors
    /// [`Error::Sigma`] for one that is not positive.
    pub fn new(mean: V, sigmas: &[f64; N]) -> Result<Self, Error> {
        Ok(Self { mean, sqrt_information: sqrt_information(sigmas)? })
    }
}

impl<V: Difference<N>, const N: usize> Factor<N> for Prior<V, N> {
    type Vars = (V,);

    fn linearize(&self, (x,): (&V,)) -> Option<Linear<Self::Vars, N>> {
        let mut jacobian = <V as Manifold>::Jacobian::<N>::zeros();
        jacobian
            .as_mut_slice()
            .copy_from_slice((self.sqrt_information * x.d_minus(&self.mean)).as_slice());
        Some((self.sqrt_information * x.minus(&self.mean), (jacobian,)))
    }

    fn residual(&self, (x,): (&V,)) -> Option<SVector<f64, N>> {
        Some(self.sqrt_information * x.minus(&self.mean))
    }
}
