//! The camera model of "Bundle adjustment in the large" (Agarwal, Snavely, Seitz, Szeliski 2010) as
//! a factor, with derivatives by hand and by dual numbers.
//!
//! P = R X + t, p = −P_xy / P_z, s = |p|², pixel = f (1 + k₁ s + k₂ s²) p. The camera looks along
//! −z. By this definition, points behind the camera project as well.

use tiepoint_ba::Factor;
use tiepoint_ba::autodiff::{Residual, RigidOf, Scalar};
use tiepoint_ba::factor::{Linear, Refs};
use tiepoint_ba::nalgebra::{Matrix2x3, SMatrix, Vector2, Vector3};
use tiepoint_geometry::Rigid3;

/// Reprojection error. Variables: `cam_from_world`, (f, k₁, k₂), `point_in_world`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Snavely {
    pub(crate) pixel: Vector2<f64>,
}

impl Factor<2> for Snavely {
    type Vars = (Rigid3, Vector3<f64>, Vector3<f64>);

    // Inlined so that landmark refinement computes only the point's block.
    #[inline(always)]
    fn linearize(
        &self,
        (cam_from_world, intrinsics, point): Refs<'_, Self::Vars>,
    ) -> Option<Linear<Self::Vars, 2>> {
        let rotation = cam_from_world.rotation.to_rotation_matrix().into_inner();
        let in_cam = rotation * point + cam_from_world.translation;
        let minus_inv_z = -1.0 / in_cam.z;
        let (u, v) = (in_cam.x * minus_inv_z, in_cam.y * minus_inv_z);
        let (f, k1, k2) = (intrinsics[0], intrinsics[1], intrinsics[2]);
        let s = u * u + v * v;
        let distortion = 1.0 + s * (k1 + k2 * s);
        let slope = 2.0 * (k1 + 2.0 * k2 * s);
        // Derivatives of both residuals with respect to P, then those of P.
        let scale = f * minus_inv_z;
        let (a, b, c) = (
            scale * (distortion + slope * u * u),
            scale * (slope * u * v),
            scale * (distortion + slope * v * v),
        );
        let (x, y) = (Vector3::new(a, b, a * u + b * v), Vector3::new(b, c, b * u + c * v));
        let (x_turn, y_turn) = (in_cam.cross(&x), in_cam.cross(&y));
        let (x_point, y_point) = (rotation.tr_mul(&x), rotation.tr_mul(&y));
        #[rustfmt::skip]
        let d_pose = SMatrix::<f64, 2, 6>::new(
            x_turn.x, x_turn.y, x_turn.z, x.x, x.y, x.z,
            y_turn.x, y_turn.y, y_turn.z, y.x, y.y, y.z,
        );
        #[rustfmt::skip]
        let d_intrinsics = Matrix2x3::new(
            distortion * u, f * s * u, f * s * s * u,
            distortion * v, f * s * v, f * s * s * v,
        );
        #[rustfmt::skip]
        let d_point = Matrix2x3::new(
            x_point.x, x_point.y, x_point.z,
            y_point.x, y_point.y, y_point.z,
        );
        let pixel = Vector2::new(u, v) * (f * distortion);
        Some((pixel - self.pixel, (d_pose, d_intrinsics, d_point)))
    }

    #[inline]
    fn residual(
        &self,
        (cam_from_world, intrinsics, point): Refs<'_, Self::Vars>,
    ) -> Option<Vector2<f64>> {
        let in_cam = *cam_from_world * *point;
        let p = -in_cam.xy() / in_cam.z;
        let s = p.norm_squared();
        Some(p * (intrinsics[0] * (1.0 + s * (intrinsics[1] + intrinsics[2] * s))) - self.pixel)
    }
}

/// The same residual for automatic differentiation: wrap it in
/// [`AutoDiff`](tiepoint_ba::autodiff::AutoDiff).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SnavelyResidual(pub(crate) Snavely);

impl Residual<2> for SnavelyResidual {
    type Vars = (Rigid3, Vector3<f64>, Vector3<f64>);

    fn residual<T: Scalar>(
        &self,
        (pose, [f, k1, k2], point): (RigidOf<T>, [T; 3], [T; 3]),
    ) -> Option<[T; 2]> {
        let [x, y, z] = pose.transform(&point);
        let p = [-x / z, -y / z];
        let s = p[0] * p[0] + p[1] * p[1];
        let scale = f * (s * (k1 + k2 * s) + 1.0);
        Some([p[0] * scale - self.0.pixel.x, p[1] * scale - self.0.pixel.y])
    }
}
