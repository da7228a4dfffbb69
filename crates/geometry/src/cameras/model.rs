//! The trait of camera models.

use std::ops::{Index, IndexMut};

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

use crate::{Block, Manifold};

/// A projected point with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Projection<M: CameraModel> {
    /// The projection, in pixels.
    pub pixel: Vector2<f64>,
    /// d pixel / d point_in_cam.
    pub d_point: Matrix2x3<f64>,
    /// d pixel / d parameters.
    pub d_params: <M::Params as Manifold>::Jacobian<2>,
}

/// A camera model: the projection from the camera frame to pixels. Unit structs implement it; the
/// parameters are an argument.
pub trait CameraModel: Copy + std::fmt::Debug + Default + Send + Sync + Sized + 'static {
    /// The parameter vector, `SVector<f64, N>`. Focal lengths and the principal point are in
    /// pixels.
    type Params: Manifold + Block + Index<usize, Output = f64> + IndexMut<usize>;
    /// Name in COLMAP.
    const NAME: &'static str;
    /// Model id in COLMAP.
    const COLMAP_ID: i32;
    /// Names of the parameters, in order.
    const PARAM_NAMES: &'static [&'static str];
    /// Indices of the focal lengths: of f, or of fx and fy. Empty for a spherical model.
    const FOCAL: &'static [usize];
    /// Indices of cx and cy. Empty for a spherical model.
    const PRINCIPAL_POINT: &'static [usize];
    /// Indices of the parameters that describe the image rather than the lens, such as its width.
    /// They are positive, and bundle adjustment does not refine them.
    const METADATA: &'static [usize] = &[];
    /// Whether the distance of a pixel from the principal point is proportional to the angle to the
    /// optical axis in first order, rather than to its tangent.
    const IS_FISHEYE: bool = false;
    /// Indices and values of the distortion parameters that an uncalibrated camera starts from,
    /// where they are not zero.
    const INITIAL_DISTORTION: &'static [(usize, f64)] = &[];
    /// Indices of the distortion parameters whose effect a rotation of the camera and the other
    /// parameters can reproduce almost exactly. They are nearly unobservable if the pose is
    /// unknown.
    const ROTATION_DEGENERATE: &'static [usize] = &[];

    /// Projects a point in the camera frame to a pixel; `None` if the model does not project it,
    /// for example a point behind a perspective camera.
    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>>;
    /// [`CameraModel::project`] with Jacobians.
    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>>;
    /// The unit ray of a pixel in the camera frame; `None` if the pixel has no ray.
    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>>;

    /// The focal lengths fx and fy, in pixels. For a spherical model, the pixels per radian on the
    /// optical axis.
    fn focal_lengths_px(params: &Self::Params) -> [f64; 2] {
        [params[Self::FOCAL[0]], params[Self::FOCAL[Self::FOCAL.len() - 1]]]
    }

    /// The pixel of the optical axis: cx and cy.
    fn principal_point(params: &Self::Params) -> Vector2<f64> {
        Vector2::new(params[Self::PRINCIPAL_POINT[0]], params[Self::PRINCIPAL_POINT[1]])
    }

    /// The residual of bundle adjustment, in pixels: `projected` − `observed`, or the shorter way
    /// around where the image is periodic.
    #[inline(always)]
    fn displacement(
        _params: &Self::Params,
        projected: &Vector2<f64>,
        observed: &Vector2<f64>,
    ) -> Vector2<f64> {
        projected - observed
    }

    /// The squared reprojection error that thresholds are compared with, in pixels²; `None` if the
    /// model does not project the point.
    #[inline(always)]
    fn squared_error_px2(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
        observed: &Vector2<f64>,
    ) -> Option<f64> {
        let pixel = Self::project(params, point_in_cam)?;
        let (x, y) = (pixel.x - observed.x, pixel.y - observed.y);
        Some(x * x + y * y)
    }
}

/// Minimum depth, in units of the scene. Points of smaller depth count as behind the camera.
pub const MIN_DEPTH: f64 = 1e-9;

/// d pixel / d point from d pixel / d(u, v), where (u, v) = (x/z, y/z).
pub(super) fn perspective_chain(
    d_uv: &Matrix2<f64>,
    uv: &Vector2<f64>,
    inv_z: f64,
) -> Matrix2x3<f64> {
    let d_xy = d_uv * inv_z;
    let d_z = -(d_xy * uv);
    Matrix2x3::from_columns(&[d_xy.column(0).into_owned(), d_xy.column(1).into_owned(), d_z])
}
