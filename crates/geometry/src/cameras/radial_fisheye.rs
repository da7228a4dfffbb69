//! Fisheye cameras with one focal length and radial distortion of the angle θ: pixel =
//! f · θ (1 + k₁ θ² + k₂ θ⁴) · (x, y)/r + c. They are [`OpencvFisheye`] with fx = fy and fewer
//! coefficients.

use nalgebra::{SMatrix, SVector, Vector2, Vector3};

use super::model::{CameraModel, Projection};
use super::opencv_fisheye::OpencvFisheye;

/// One focal length and one distortion coefficient of θ: f, cx, cy, k.
#[derive(Clone, Copy, Debug, Default)]
pub struct SimpleRadialFisheye;

/// One focal length and two distortion coefficients of θ: f, cx, cy, k1, k2.
#[derive(Clone, Copy, Debug, Default)]
pub struct RadialFisheye;

fn as_radial(p: &SVector<f64, 4>) -> SVector<f64, 5> {
    SVector::<f64, 5>::new(p[0], p[1], p[2], p[3], 0.0)
}

fn as_opencv(p: &SVector<f64, 5>) -> SVector<f64, 8> {
    SVector::from([p[0], p[0], p[1], p[2], p[3], p[4], 0.0, 0.0])
}

impl CameraModel for SimpleRadialFisheye {
    type Params = SVector<f64, 4>;
    const NAME: &'static str = "SIMPLE_RADIAL_FISHEYE";
    const COLMAP_ID: i32 = 8;
    const PARAM_NAMES: &'static [&'static str] = &["f", "cx", "cy", "k"];
    const FOCAL: &'static [usize] = &[0];
    const PRINCIPAL_POINT: &'static [usize] = &[1, 2];
    const IS_FISHEYE: bool = true;

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        RadialFisheye::project(&as_radial(params), point_in_cam)
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let Projection { pixel, d_point, d_params } =
            RadialFisheye::project_with_jacobian(&as_radial(params), point_in_cam)?;
        let d_params: SMatrix<f64, 2, 4> = d_params.fixed_columns::<4>(0).into_owned();
        Some(Projection { pixel, d_point, d_params })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        RadialFisheye::unproject(&as_radial(params), pixel)
    }
}

impl CameraModel for RadialFisheye {
    type Params = SVector<f64, 5>;
    const NAME: &'static str = "RADIAL_FISHEYE";
    const COLMAP_ID: i32 = 9;
    const PARAM_NAMES: &'static [&'static str] = &["f", "cx", "cy", "k1", "k2"];
    const FOCAL: &'static [usize] = &[0];
    const PRINCIPAL_POINT: &'static [usize] = &[1, 2];
    const IS_FISHEYE: bool = true;

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        OpencvFisheye::project(&as_opencv(params), point_in_cam)
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let Projection { pixel, d_point, d_params: d } =
            OpencvFisheye::project_with_jacobian(&as_opencv(params), point_in_cam)?;
        let d_params = SMatrix::from_columns(&[
            d.column(0) + d.column(1),
            d.column(2).into_owned(),
            d.column(3).into_owned(),
            d.column(4).into_owned(),
            d.column(5).into_owned(),
        ]);
        Some(Projection { pixel, d_point, d_params })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        OpencvFisheye::unproject(&as_opencv(params), pixel)
    }
}
