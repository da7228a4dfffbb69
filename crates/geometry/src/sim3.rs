//! Similarity transforms: the gauge freedom of a reconstruction from images alone.

use std::ops::Mul;

use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3};

use crate::{Manifold, Rigid3};

/// `point_in_b = scale * (rotation * point_in_a) + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sim3 {
    /// Length in frame b of a unit length of frame a; positive.
    pub scale: f64,
    /// Rotation of b from a.
    pub rotation: UnitQuaternion<f64>,
    /// The origin of frame a in frame b.
    pub translation: Vector3<f64>,
}

impl Sim3 {
    /// The identity transform.
    pub fn identity() -> Self {
        Self { scale: 1.0, rotation: UnitQuaternion::identity(), translation: Vector3::zeros() }
    }

    /// `a_from_b` of this `b_from_a`.
    pub fn inverse(&self) -> Self {
        let (rotation, scale) = (self.rotation.inverse(), 1.0 / self.scale);
        Self { scale, rotation, translation: -(rotation * self.translation) * scale }
    }

    /// The rigid transform of the same rotation and translation.
    pub fn without_scale(&self) -> Rigid3 {
        Rigid3 { rotation: self.rotation, translation: self.translation }
    }

    /// The pose `cam_from_new` of a camera after the world was transformed by `self`, which is
    /// `new_from_old`. Projections do not change, because they do not depend on the scale.
    pub fn transform_pose(&self, cam_from_old: &Rigid3) -> Rigid3 {
        let rotation = cam_from_old.rotation * self.rotation.inverse();
        Rigid3 {
            rotation,
            translation: cam_from_old.translation * self.scale - rotation * self.translation,
        }
    }
}

/// `c_from_b * b_from_a == c_from_a`.
impl Mul for Sim3 {
    type Output = Sim3;
    fn mul(self, b_from_a: Sim3) -> Sim3 {
        Sim3 {
            scale: self.scale * b_from_a.scale,
            rotation: self.rotation * b_from_a.rotation,
            translation: self * b_from_a.translation,
        }
    }
}

/// `b_from_a * point_in_a == point_in_b`.
impl Mul<Vector3<f64>> for Sim3 {
    type Output = Vector3<f64>;
    fn mul(self, point_in_a: Vector3<f64>) -> Vector3<f64> {
        (self.rotation * point_in_a) * self.scale + self.translation
    }
}

/// The tangent of a [`Rigid3`], then the logarithm of the scale. See CONVENTIONS.md.
impl Manifold for Sim3 {
    const DOF: usize = 7;
    type Tangent = SVector<f64, 7>;
    type Jacobian<const R: usize> = SMatrix<f64, R, 7>;
    fn plus(&self, delta: &Self::Tangent) -> Self {
        let moved = self.without_scale().plus(&delta.fixed_rows::<6>(0).into_owned());
        Self {
            scale: self.scale * delta[6].exp(),
            rotation: moved.rotation,
            translation: moved.translation,
        }
    }
    fn minus(&self, base: &Self) -> Self::Tangent {
        let mut delta = SVector::<f64, 7>::zeros();
        delta.fixed_rows_mut::<6>(0).copy_from(&self.without_scale().minus(&base.without_scale()));
        delta[6] = (self.scale / base.scale).ln();
        delta
    }
}
