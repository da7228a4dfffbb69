use nalgebra::{Matrix6, SVector};
use tiepoint_geometry::{Rigid3, so3};

use super::difference::from_sigmas;
use crate::error::Error;
use crate::factor::{Factor, Linear};

/// The relative pose of two frames was measured: variables (`a_from_world`, `b_from_world`), residual
/// A (`b_from_world · world_from_a` ⊖ `b_from_a`), rotation first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Between {
    /// The measurement.
    pub b_from_a: Rigid3,
    /// A, with AᵀA the inverse covariance of (rotation, translation).
    pub sqrt_information: Matrix6<f64>,
}

impl Between {
    /// From standard deviations of the rotation (radians, about the axes of b) and of the translation; infinite ones say
    /// nothing.
    pub fn new(b_from_a: Rigid3, sigmas: &[f64; 6]) -> Result<Self, Error> {
        Ok(Self { b_from_a, sqrt_information: from_sigmas(sigmas)? })
    }

    fn error(&self, rotation: &nalgebra::UnitQuaternion<f64>, a: &Rigid3, b: &Rigid3) -> SVector<f64, 6> {
        let r_rotation = so3::log(&(rotation * self.b_from_a.rotation.inverse()));
        let r_translation = b.translation - rotation * a.translation - self.b_from_a.translation;
        let mut residual = SVector::<f64, 6>::zeros();
        residual.fixed_rows_mut::<3>(0).copy_from(&r_rotation);
        residual.fixed_rows_mut::<3>(3).copy_from(&r_translation);
        residual
    }
}

impl Factor<6> for Between {
    type Vars = (Rigid3, Rigid3);

    /// With R = R_b R_aᵀ: R_b ← Exp(δ) R_b makes R ← Exp(δ) R, and R_a ← Exp(δ) R_a makes R ← Exp(−R δ) R.
    fn linearize(&self, (a, b): (&Rigid3, &Rigid3)) -> Option<Linear<Self::Vars, 6>> {
        let rotation = b.rotation * a.rotation.inverse();
        let residual = self.error(&rotation, a, b);
        let r = rotation.to_rotation_matrix().into_inner();
        let d_log = so3::left_jacobian_inverse(&residual.fixed_rows::<3>(0).into_owned());
        let lever = so3::hat(&(r * a.translation));
        let (mut d_a, mut d_b) = (Matrix6::zeros(), Matrix6::identity());
        d_b.fixed_view_mut::<3, 3>(0, 0).copy_from(&d_log);
        d_b.fixed_view_mut::<3, 3>(3, 0).copy_from(&lever);
        d_a.fixed_view_mut::<3, 3>(0, 0).copy_from(&(-d_log * r));
        d_a.fixed_view_mut::<3, 3>(3, 0).copy_from(&(-lever * r));
        d_a.fixed_view_mut::<3, 3>(3, 3).copy_from(&-r);
        let w = &self.sqrt_information;
        Some((w * residual, (w * d_a, w * d_b)))
    }

    fn residual(&self, (a, b): (&Rigid3, &Rigid3)) -> Option<SVector<f64, 6>> {
        Some(self.sqrt_information * self.error(&(b.rotation * a.rotation.inverse()), a, b))
    }
}
