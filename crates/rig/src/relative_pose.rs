//! The relative pose p of two cameras at one frame: three numbers of translation and three of
//! rotation.
//!
//! The first camera is the reference camera, whose frame is the rig frame. For the poses
//! `rig_from_world` = (R₁, t₁) of the first and `cam_from_world` = (R₂, t₂) of the second camera,
//! c = R₁ c₂ + t₁ with c₂ = −R₂ᵀ t₂ is the second camera's centre in the first camera's frame, and
//! a = Log(R₂ R₁ᵀ) is the axis-angle vector (radians) of the rotation `cam_from_rig`. In the paper
//! they are the left and the right camera. With the perturbations (δ, τ) of CONVENTIONS.md and
//! Q = R₂ R₁ᵀ:
//!
//! | | δ₁ | τ₁ | δ₂ | τ₂ |
//! |---|---|---|---|---|
//! | c | −[c]ₓ | I | 0 | −Qᵀ |
//! | a | −J_l⁻¹(a) Q | 0 | J_l⁻¹(a) | 0 |
//!
//! J_l is the left Jacobian of SO(3). Axis-angle vectors wrap at π. For cameras that look in
//! opposite directions, take differences of `a` after [`RelativePose::nearest_to`].

use tiepoint_geometry::nalgebra::{SMatrix, SVector, Vector3};
use tiepoint_geometry::{Rigid3, so3};

/// p of Huang, Elhashash & Qin 2022, Eq. (3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativePose {
    /// The second camera's centre in the first camera's frame, in model units.
    pub translation: Vector3<f64>,
    /// Axis-angle vector of the rotation `cam_from_rig`, in radians.
    pub axis_angle: Vector3<f64>,
}

/// A relative pose with its derivatives with respect to the tangents (rotation, translation) of the
/// two camera poses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LinearRelativePose {
    pub(crate) p: RelativePose,
    pub(crate) d_reference: SMatrix<f64, 6, 6>,
    pub(crate) d_cam: SMatrix<f64, 6, 6>,
}

impl RelativePose {
    /// From the poses of the first and the second camera.
    pub fn between(rig_from_world: &Rigid3, cam_from_world: &Rigid3) -> Self {
        let cam_in_world = cam_from_world.origin_in_a();
        Self {
            translation: *rig_from_world * cam_in_world,
            axis_angle: so3::log(&(cam_from_world.rotation * rig_from_world.rotation.inverse())),
        }
    }

    /// The same relative pose as a rigid transform.
    pub fn cam_from_rig(&self) -> Rigid3 {
        let rotation = so3::exp(&self.axis_angle);
        Rigid3::new(rotation, -(rotation * self.translation))
    }

    /// Distance between the second camera's centres in model units, and angle between the rotations
    /// in radians.
    pub fn distance_and_angle(&self, other: &RelativePose) -> (f64, f64) {
        let angle = so3::exp(&self.axis_angle).angle_to(&so3::exp(&other.axis_angle));
        ((self.translation - other.translation).norm(), angle)
    }

    /// (translation, axis-angle) as one vector, in the order of Eq. (3).
    pub fn to_vector(&self) -> SVector<f64, 6> {
        let (t, a) = (&self.translation, &self.axis_angle);
        SVector::<f64, 6>::new(t.x, t.y, t.z, a.x, a.y, a.z)
    }

    /// The same rotation, represented by the axis-angle vector nearest to that of `other`: full
    /// turns about the axis are added.
    pub fn nearest_to(&self, other: &RelativePose) -> Self {
        let angle = self.axis_angle.norm();
        if angle == 0.0 {
            return *self;
        }
        let axis = self.axis_angle / angle;
        let full_turns = ((other.axis_angle.dot(&axis) - angle) / std::f64::consts::TAU).round();
        Self { axis_angle: axis * (angle + full_turns * std::f64::consts::TAU), ..*self }
    }

    /// The relative pose and its derivatives.
    pub(crate) fn linearize(
        rig_from_world: &Rigid3,
        cam_from_world: &Rigid3,
    ) -> LinearRelativePose {
        let p = Self::between(rig_from_world, cam_from_world);
        let q = (cam_from_world.rotation * rig_from_world.rotation.inverse())
            .to_rotation_matrix()
            .into_inner();
        let mut d_reference = SMatrix::<f64, 6, 6>::zeros();
        let mut d_cam = SMatrix::<f64, 6, 6>::zeros();
        d_reference.fixed_view_mut::<3, 3>(0, 0).copy_from(&-so3::hat(&p.translation));
        d_reference.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
        d_cam.fixed_view_mut::<3, 3>(0, 3).copy_from(&-q.transpose());
        LinearRelativePose { p, d_reference, d_cam }.with_rotation(&q)
    }
}

impl LinearRelativePose {
    /// Computes the rows of the rotation for the branch of `p`.
    fn with_rotation(mut self, q: &tiepoint_geometry::nalgebra::Matrix3<f64>) -> Self {
        let inverse = so3::left_jacobian_inverse(&self.p.axis_angle);
        self.d_reference.fixed_view_mut::<3, 3>(3, 0).copy_from(&-(inverse * q));
        self.d_cam.fixed_view_mut::<3, 3>(3, 0).copy_from(&inverse);
        self
    }

    /// The same relative pose in the branch of the axis-angle vector nearest to `other`.
    pub(crate) fn nearest_to(mut self, other: &RelativePose) -> Self {
        let nearest = self.p.nearest_to(other);
        if nearest != self.p {
            self.p = nearest;
            let q = so3::exp(&nearest.axis_angle).to_rotation_matrix().into_inner();
            self = self.with_rotation(&q);
        }
        self
    }
}
