//! Derivatives of `minus`, the difference of two values of a variable.

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion};
use tiepoint_geometry::{Manifold, Rigid3, Sim3, so3};

/// A manifold of `N` dimensions with a differentiable `minus`.
pub trait Difference<const N: usize>: Manifold<Tangent = SVector<f64, N>> {
    /// d (x ⊟ base) / dx.
    fn d_minus(&self, base: &Self) -> SMatrix<f64, N, N>;
}

impl<const N: usize> Difference<N> for SVector<f64, N> {
    fn d_minus(&self, _: &Self) -> SMatrix<f64, N, N> {
        SMatrix::identity()
    }
}

impl Difference<1> for f64 {
    fn d_minus(&self, _: &Self) -> SMatrix<f64, 1, 1> {
        SMatrix::identity()
    }
}

/// Log(Exp(δ) R) ≈ Log(R) + J_l⁻¹(Log(R)) δ.
impl Difference<3> for UnitQuaternion<f64> {
    fn d_minus(&self, base: &Self) -> Matrix3<f64> {
        so3::left_jacobian_inverse(&self.minus(base))
    }
}

/// A motion (δ, τ) of x changes the motion (Exp r, p) from the base to x to (Exp(δ) Exp(r), Exp(δ)
/// p + τ). Rows and columns from the seventh on are those of the identity.
fn d_motion<const N: usize>(r_and_p: &SVector<f64, N>) -> SMatrix<f64, N, N> {
    let (r, p) = (r_and_p.fixed_rows::<3>(0).into_owned(), r_and_p.fixed_rows::<3>(3).into_owned());
    let mut jacobian = SMatrix::<f64, N, N>::identity();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&so3::left_jacobian_inverse(&r));
    jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&-so3::hat(&p));
    jacobian
}

impl Difference<6> for Rigid3 {
    fn d_minus(&self, base: &Self) -> SMatrix<f64, 6, 6> {
        d_motion(&self.minus(base))
    }
}

impl Difference<7> for Sim3 {
    fn d_minus(&self, base: &Self) -> SMatrix<f64, 7, 7> {
        d_motion(&self.minus(base))
    }
}

/// Diagonal square root of the information matrix, from standard deviations. Infinite ones give
/// zeros.
pub(super) fn sqrt_information<const N: usize>(
    sigmas: &[f64; N],
) -> Result<SMatrix<f64, N, N>, crate::Error> {
    if let Some((index, &value)) =
        sigmas.iter().enumerate().find(|(_, sigma)| sigma.is_nan() || **sigma <= 0.0)
    {
        return Err(crate::Error::Sigma { index, value });
    }
    Ok(SMatrix::from_diagonal(&SVector::from_iterator(sigmas.iter().map(|sigma| 1.0 / sigma))))
}
