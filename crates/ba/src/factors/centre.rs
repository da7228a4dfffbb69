//! Measured positions of cameras.

use nalgebra::{Matrix3, SMatrix, Vector3};
use tiepoint_geometry::Rigid3;

use super::difference::sqrt_information;
use crate::error::Error;
use crate::factor::{Factor, Linear};

/// A measured position of a point that is fixed to a camera, such as its centre or an antenna, in
/// the world frame. Residual: A (p − `measured`), with p the point for the pose `cam_from_world`
/// and A the square root of the information matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Centre {
    /// The measured position.
    pub measured: Vector3<f64>,
    /// A, where AᵀA is the inverse covariance of the measurement along the axes of the world.
    pub sqrt_information: Matrix3<f64>,
    /// The point in the camera frame; zero for the centre.
    pub in_camera: Vector3<f64>,
}

impl Centre {
    /// The centre of the camera, from a standard deviation for each axis. An infinite one removes
    /// the axis.
    ///
    /// # Errors
    /// [`Error::Sigma`] for one that is not positive.
    pub fn new(measured: Vector3<f64>, sigmas: &[f64; 3]) -> Result<Self, Error> {
        let sqrt_information = sqrt_information(sigmas)?;
        Ok(Self { measured, sqrt_information, in_camera: Vector3::zeros() })
    }

    fn of(&self, cam_from_world: &Rigid3) -> Vector3<f64> {
        let point =
            cam_from_world.rotation.inverse() * (self.in_camera - cam_from_world.translation);
        self.sqrt_information * (point - self.measured)
    }

    /// With respect to the tangent of `cam_from_world`: moving the camera frame by it moves the
    /// point by the opposite, in the axes of the camera.
    fn d_pose(&self, cam_from_world: &Rigid3) -> SMatrix<f64, 3, 6> {
        let world_from_cam = *cam_from_world.rotation.inverse().to_rotation_matrix().matrix();
        let by_motion = self.sqrt_information * world_from_cam;
        let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
        let by_rotation = by_motion * self.in_camera.cross_matrix();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_rotation);
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-by_motion);
        jacobian
    }
}

impl Factor<3> for Centre {
    type Vars = (Rigid3,);

    fn linearize(&self, (pose,): (&Rigid3,)) -> Option<Linear<Self::Vars, 3>> {
        Some((self.of(pose), (self.d_pose(pose),)))
    }

    fn residual(&self, (pose,): (&Rigid3,)) -> Option<Vector3<f64>> {
        Some(self.of(pose))
    }
}

/// [`Centre`] of a camera whose pose is `cam_from_rig` · `rig_from_world`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigCentre(pub Centre);

impl Factor<3> for RigCentre {
    type Vars = (Rigid3, Rigid3);

    fn linearize(
        &self,
        (cam_from_rig, rig_from_world): (&Rigid3, &Rigid3),
    ) -> Option<Linear<Self::Vars, 3>> {
        let pose = *cam_from_rig * *rig_from_world;
        let by_pose = self.0.d_pose(&pose);
        Some((self.0.of(&pose), (by_pose, by_pose * cam_from_rig.adjoint())))
    }

    fn residual(&self, (cam_from_rig, rig_from_world): (&Rigid3, &Rigid3)) -> Option<Vector3<f64>> {
        Some(self.0.of(&(*cam_from_rig * *rig_from_world)))
    }
}
