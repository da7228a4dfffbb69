use nalgebra::{Matrix6, SVector};
use tiepoint_geometry::{Manifold, Rigid3};

use super::difference::{d_motion, from_sigmas};
use crate::error::Error;
use crate::factor::{Factor, Linear};

/// The relative pose of two frames was measured: variables (`a_from_world`, `b_from_world`), residual
/// A (`b_from_world · world_from_a` ⊖ `b_from_a`), rotation first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Between {
    /// The measurement.
    pub b_from_a: Rigid3,
    /// A, with AᵀA the inverse covariance of the tangent (rotation, translation) of `b_from_a`.
    pub sqrt_information: Matrix6<f64>,
}

impl Between {
    /// From standard deviations of the rotation (radians, about the axes of b) and of the place of b's origin, along the axes of b;
    /// infinite ones say nothing.
    pub fn new(b_from_a: Rigid3, sigmas: &[f64; 6]) -> Result<Self, Error> {
        Ok(Self { b_from_a, sqrt_information: from_sigmas(sigmas)? })
    }

    fn error(&self, b_from_a: &Rigid3) -> SVector<f64, 6> {
        b_from_a.minus(&self.b_from_a)
    }
}

impl Factor<6> for Between {
    type Vars = (Rigid3, Rigid3);

    /// With B = (R, t) = `b_from_a`: a motion (δ, τ) of b is one of B, and one of a moves B by its opposite, seen in b: to first order by
    /// `(−R δ, −R τ − [t]ₓ R δ)`.
    fn linearize(&self, (a, b): (&Rigid3, &Rigid3)) -> Option<Linear<Self::Vars, 6>> {
        let b_from_a = *b * a.inverse();
        let residual = self.error(&b_from_a);
        let d_b = self.sqrt_information * d_motion(&residual);
        Some((self.sqrt_information * residual, (-d_b * b_from_a.adjoint(), d_b)))
    }

    fn residual(&self, (a, b): (&Rigid3, &Rigid3)) -> Option<SVector<f64, 6>> {
        Some(self.sqrt_information * self.error(&(*b * a.inverse())))
    }
}
