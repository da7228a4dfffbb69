//! Rigid transforms of 3-D space.

use std::ops::Mul;

use nalgebra::{Matrix3x4, SMatrix, SVector, UnitQuaternion, Vector3};

use crate::{Manifold, so3};

/// A rotation followed by a translation: `point_in_b = rotation * point_in_a + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid3 {
    /// Rotation of b from a.
    pub rotation: UnitQuaternion<f64>,
    /// The origin of frame a in frame b.
    pub translation: Vector3<f64>,
}

impl Rigid3 {
    /// The identity transform.
    pub fn identity() -> Self {
        Self { rotation: UnitQuaternion::identity(), translation: Vector3::zeros() }
    }

    /// From a rotation and a translation.
    pub fn new(rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation, translation }
    }

    /// From an axis-angle vector (radians) and a translation.
    pub fn from_axis_angle(axis_angle: Vector3<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation: so3::exp(&axis_angle), translation }
    }

    /// `a_from_b` of this `b_from_a`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// The origin of frame b in frame a. For `cam_from_world` it is the camera centre in the world.
    pub fn origin_in_a(&self) -> Vector3<f64> {
        -(self.rotation.inverse() * self.translation)
    }

    /// The adjoint matrix Ad, with T Exp(ξ) = Exp(Ad ξ) T to first order: it maps a tangent
    /// ξ = (δ, τ) of frame a to the tangent `(R δ, R τ + [t]ₓ R δ)` of frame b.
    pub fn adjoint(&self) -> SMatrix<f64, 6, 6> {
        let rotation = self.rotation.to_rotation_matrix().into_inner();
        let mut adjoint = SMatrix::<f64, 6, 6>::zeros();
        adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        adjoint.fixed_view_mut::<3, 3>(3, 0).copy_from(&(so3::hat(&self.translation) * rotation));
        adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        adjoint
    }

    /// The 3×4 matrix [R | t].
    pub fn to_matrix(&self) -> Matrix3x4<f64> {
        let mut matrix = Matrix3x4::zeros();
        matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(self.rotation.to_rotation_matrix().matrix());
        matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.translation);
        matrix
    }
}

/// `c_from_b * b_from_a == c_from_a`.
impl Mul for Rigid3 {
    type Output = Rigid3;
    fn mul(self, b_from_a: Rigid3) -> Rigid3 {
        let mut rotation = self.rotation * b_from_a.rotation;
        rotation.renormalize_fast();
        Rigid3 { rotation, translation: self.rotation * b_from_a.translation + self.translation }
    }
}

/// `b_from_a * point_in_a == point_in_b`.
impl Mul<Vector3<f64>> for Rigid3 {
    type Output = Vector3<f64>;
    fn mul(self, point_in_a: Vector3<f64>) -> Vector3<f64> {
        self.rotation * point_in_a + self.translation
    }
}

/// The tangent (δ, τ), rotation first, perturbs in the target frame about its origin: a camera
/// rotates about its own centre. See CONVENTIONS.md.
impl Manifold for Rigid3 {
    const DOF: usize = 6;
    type Tangent = SVector<f64, 6>;
    type Jacobian<const R: usize> = SMatrix<f64, R, 6>;
    fn plus(&self, delta: &Self::Tangent) -> Self {
        let d_rotation = so3::exp(&delta.fixed_rows::<3>(0).into_owned());
        Self {
            rotation: d_rotation * self.rotation,
            translation: d_rotation * self.translation + delta.fixed_rows::<3>(3),
        }
    }
    fn minus(&self, base: &Self) -> Self::Tangent {
        let d_rotation = self.rotation * base.rotation.inverse();
        let mut delta = SVector::<f64, 6>::zeros();
        delta.fixed_rows_mut::<3>(0).copy_from(&so3::log(&d_rotation));
        delta.fixed_rows_mut::<3>(3).copy_from(&(self.translation - d_rotation * base.translation));
        delta
    }
}
