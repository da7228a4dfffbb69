use nalgebra::{Matrix2x3, SMatrix, Vector1, Vector2, Vector3};
use tiepoint_geometry::{Block, CameraModel, Rigid3};

use crate::factor::{Factor, Linear, Refs};

/// Reprojection error. Variables: camera parameters, `cam_from_world`, `point_in_world`. Residual:
/// (project(parameters, `cam_from_world` · `point_in_world`) − pixel) / sigma, where the difference
/// is [`CameraModel::displacement`]. Invalid if the point does not project into the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reprojection<M> {
    /// The measured pixel.
    pub pixel: Vector2<f64>,
    /// Standard deviation of each coordinate, in pixels.
    pub sigma_px: f64,
    /// The camera model.
    pub model: M,
}

impl<M: CameraModel> Reprojection<M> {
    /// An observation at `pixel`.
    pub fn new(pixel: Vector2<f64>, sigma_px: f64) -> Self {
        Self { pixel, sigma_px, model: M::default() }
    }
}

/// Jacobian of the projection with respect to the pose, given the point in the camera frame: Exp(δ)
/// p + τ ≈ p + δ × p + τ.
#[inline(always)]
fn d_pose(d_point: &Matrix2x3<f64>, moved: &Vector3<f64>) -> SMatrix<f64, 2, 6> {
    let [x, y] = [0, 1].map(|r| Vector3::new(d_point[(r, 0)], d_point[(r, 1)], d_point[(r, 2)]));
    // d · (δ × p) = δ · (p × d).
    let (x_turn, y_turn) = (moved.cross(&x), moved.cross(&y));
    let x = [x_turn.x, x_turn.y, x_turn.z, x.x, x.y, x.z];
    let y = [y_turn.x, y_turn.y, y_turn.z, y.x, y.y, y.z];
    SMatrix::from_fn(|r, c| if r == 0 { x[c] } else { y[c] })
}

#[inline(always)]
fn scale<B: Block>(mut block: B, factor: f64) -> B {
    block.as_mut_slice().iter_mut().for_each(|number| *number *= factor);
    block
}

impl<M: CameraModel> Factor<2> for Reprojection<M> {
    type Vars = (M::Params, Rigid3, Vector3<f64>);

    // Inlined for the refinement of points, which then computes their block alone.
    #[inline(always)]
    fn linearize(
        &self,
        (params, cam_from_world, point): Refs<'_, Self::Vars>,
    ) -> Option<Linear<Self::Vars, 2>> {
        let rotation = cam_from_world.rotation.to_rotation_matrix().into_inner();
        let in_cam = rotation * point + cam_from_world.translation;
        let projected = M::project_with_jacobian(params, &in_cam)?;
        let weight = 1.0 / self.sigma_px;
        let d_point = projected.d_point * weight;
        let jacobians =
            (scale(projected.d_params, weight), d_pose(&d_point, &in_cam), d_point * rotation);
        let error_px = M::displacement(params, &projected.pixel, &self.pixel);
        Some((error_px * weight, jacobians))
    }

    #[inline]
    fn residual(
        &self,
        (params, cam_from_world, point): Refs<'_, Self::Vars>,
    ) -> Option<Vector2<f64>> {
        let pixel = M::project(params, &(*cam_from_world * *point))?;
        Some(M::displacement(params, &pixel, &self.pixel) * (1.0 / self.sigma_px))
    }
}

/// Reprojection error of a camera on a rig. Variables: camera parameters, `cam_from_rig`,
/// `rig_from_world`, `point_in_world`. Otherwise as [`Reprojection`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigReprojection<M> {
    /// The measured pixel.
    pub pixel: Vector2<f64>,
    /// Standard deviation of each coordinate, in pixels.
    pub sigma_px: f64,
    /// The camera model.
    pub model: M,
}

impl<M: CameraModel> RigReprojection<M> {
    /// An observation at `pixel`.
    pub fn new(pixel: Vector2<f64>, sigma_px: f64) -> Self {
        Self { pixel, sigma_px, model: M::default() }
    }
}

impl<M: CameraModel> Factor<2> for RigReprojection<M> {
    type Vars = (M::Params, Rigid3, Rigid3, Vector3<f64>);

    #[inline]
    fn linearize(
        &self,
        (params, cam_from_rig, rig_from_world, point): Refs<'_, Self::Vars>,
    ) -> Option<Linear<Self::Vars, 2>> {
        let to_rig = rig_from_world.rotation.to_rotation_matrix().into_inner();
        let to_cam = cam_from_rig.rotation.to_rotation_matrix().into_inner();
        let in_rig = to_rig * point + rig_from_world.translation;
        let in_cam = to_cam * in_rig + cam_from_rig.translation;
        let projected = M::project_with_jacobian(params, &in_cam)?;
        let weight = 1.0 / self.sigma_px;
        let d_in_cam = projected.d_point * weight;
        let d_in_rig = d_in_cam * to_cam;
        let jacobians = (
            scale(projected.d_params, weight),
            d_pose(&d_in_cam, &in_cam),
            d_pose(&d_in_rig, &in_rig),
            d_in_rig * to_rig,
        );
        let error_px = M::displacement(params, &projected.pixel, &self.pixel);
        Some((error_px * weight, jacobians))
    }

    #[inline]
    fn residual(
        &self,
        (params, cam_from_rig, rig_from_world, point): Refs<'_, Self::Vars>,
    ) -> Option<Vector2<f64>> {
        let pixel = M::project(params, &(*cam_from_rig * (*rig_from_world * *point)))?;
        Some(M::displacement(params, &pixel, &self.pixel) * (1.0 / self.sigma_px))
    }
}

/// Reprojection error with a shift of unknown amount, such as the readout time of a rolling
/// shutter. Variables: camera parameters, `cam_from_world`, amount, `point_in_world`. Residual:
/// that of [`Reprojection`] plus amount · shift / sigma.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShiftedReprojection<M> {
    /// The reprojection error without the shift.
    pub unshifted: Reprojection<M>,
    /// Shift of the projection in pixels, for an amount of one.
    pub shift: Vector2<f64>,
}

impl<M: CameraModel> Factor<2> for ShiftedReprojection<M> {
    type Vars = (M::Params, Rigid3, Vector1<f64>, Vector3<f64>);

    #[inline]
    fn linearize(
        &self,
        (params, cam_from_world, amount, point): Refs<'_, Self::Vars>,
    ) -> Option<Linear<Self::Vars, 2>> {
        let (residual, (d_params, d_pose, d_point)) =
            self.unshifted.linearize((params, cam_from_world, point))?;
        let shift = self.shift / self.unshifted.sigma_px;
        Some((residual + shift * amount.x, (d_params, d_pose, shift, d_point)))
    }

    #[inline]
    fn residual(
        &self,
        (params, cam_from_world, amount, point): Refs<'_, Self::Vars>,
    ) -> Option<Vector2<f64>> {
        let residual = self.unshifted.residual((params, cam_from_world, point))?;
        Some(residual + self.shift * (amount.x / self.unshifted.sigma_px))
    }
}
