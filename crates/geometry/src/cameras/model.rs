//! What a camera model is.

use std::ops::{Index, IndexMut};

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

use crate::{Block, Manifold};

/// A projected point with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Projection<M: CameraModel> {
    /// Where, in pixels.
    pub pixel: Vector2<f64>,
    /// d pixel / d point_in_cam.
    pub d_point: Matrix2x3<f64>,
    /// d pixel / d parameters.
    pub d_params: <M::Params as Manifold>::Jacobian<2>,
}

/// How one family of lenses maps rays to pixels. Implemented by unit structs; parameters are an
/// argument.
pub trait CameraModel: Copy + std::fmt::Debug + Default + Send + Sync + Sized + 'static {
    /// The parameter vector, `SVector<f64, N>`, in pixels where it is a length.
    type Params: Manifold + Block + Index<usize, Output = f64> + IndexMut<usize>;
    /// COLMAP's name.
    const NAME: &'static str;
    /// COLMAP's number.
    const COLMAP_ID: i32;
    /// Names of the parameters, in order.
    const PARAM_NAMES: &'static [&'static str];
    /// Indices of the focal lengths: of f, or of fx and fy.
    const FOCAL: &'static [usize];
    /// Indices of cx and cy.
    const PRINCIPAL_POINT: [usize; 2];
    /// Indices of distortion that a turn of the camera does as well, together with the other
    /// parameters: with the pose unknown, images do not tell them.
    const TURN: &'static [usize] = &[];

    /// The pixel of a point in the camera's frame; `None` where the model does not see it (behind a
    /// perspective camera).
    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>>;
    /// The same with derivatives.
    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>>;
    /// The unit ray, in the camera's frame, that is seen at a pixel; `None` where no ray is.
    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>>;
}

/// Points nearer to the plane of the camera than this (in units of the scene) count as behind it.
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
