//! Perspective cameras with one focal length and radial distortion: with (u, v) = (x/z, y/z) and r²
//! = u² + v², pixel = f · (1 + k₁ r² + k₂ r⁴) · (u, v) + c.

use nalgebra::{Matrix2, Matrix2x4, Matrix2x5, SVector, Vector2, Vector3};

use super::model::{CameraModel, MIN_DEPTH, Projection, perspective_chain};
use super::undistort::undistort;

/// One focal length and one distortion coefficient: f, cx, cy, k.
#[derive(Clone, Copy, Debug, Default)]
pub struct SimpleRadial;

/// One focal length and two distortion coefficients: f, cx, cy, k1, k2.
#[derive(Clone, Copy, Debug, Default)]
pub struct Radial;

/// [`Radial`] with k2 = 0.
fn as_radial(params: &SVector<f64, 4>) -> SVector<f64, 5> {
    SVector::<f64, 5>::new(params[0], params[1], params[2], params[3], 0.0)
}

impl CameraModel for SimpleRadial {
    type Params = SVector<f64, 4>;
    const NAME: &'static str = "SIMPLE_RADIAL";
    const COLMAP_ID: i32 = 2;
    const PARAM_NAMES: &'static [&'static str] = &["f", "cx", "cy", "k"];
    const FOCAL: &'static [usize] = &[0];
    const PRINCIPAL_POINT: &'static [usize] = &[1, 2];

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        Radial::project(&as_radial(params), point_in_cam)
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let Projection { pixel, d_point, d_params } =
            Radial::project_with_jacobian(&as_radial(params), point_in_cam)?;
        let d_params: Matrix2x4<f64> = d_params.fixed_columns::<4>(0).into_owned();
        Some(Projection { pixel, d_point, d_params })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        Radial::unproject(&as_radial(params), pixel)
    }
}

/// The distorted point of the plane z = 1 and its derivative.
fn distort(params: &SVector<f64, 5>, uv: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
    let [k1, k2] = [params[3], params[4]];
    let r2 = uv.norm_squared();
    let factor = 1.0 + r2 * (k1 + r2 * k2);
    let d_factor = 2.0 * (k1 + 2.0 * k2 * r2);
    (uv * factor, Matrix2::identity() * factor + uv * uv.transpose() * d_factor)
}

impl CameraModel for Radial {
    type Params = SVector<f64, 5>;
    const NAME: &'static str = "RADIAL";
    const COLMAP_ID: i32 = 3;
    const PARAM_NAMES: &'static [&'static str] = &["f", "cx", "cy", "k1", "k2"];
    const FOCAL: &'static [usize] = &[0];
    const PRINCIPAL_POINT: &'static [usize] = &[1, 2];

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        if point_in_cam.z < MIN_DEPTH {
            return None;
        }
        let uv = point_in_cam.xy() / point_in_cam.z;
        let r2 = uv.norm_squared();
        let scale = params[0] * (1.0 + r2 * (params[3] + r2 * params[4]));
        Some(Vector2::new(scale * uv.x + params[1], scale * uv.y + params[2]))
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        if point_in_cam.z < MIN_DEPTH {
            return None;
        }
        let inv_z = 1.0 / point_in_cam.z;
        let uv = point_in_cam.xy() * inv_z;
        let (distorted, d_uv) = distort(params, &uv);
        let (f, r2) = (params[0], uv.norm_squared());
        let d_k1 = uv * (f * r2);
        let d_k2 = d_k1 * r2;
        let d_params = Matrix2x5::new(
            distorted.x,
            1.0,
            0.0,
            d_k1.x,
            d_k2.x,
            distorted.y,
            0.0,
            1.0,
            d_k1.y,
            d_k2.y,
        );
        Some(Projection {
            pixel: Vector2::new(f * distorted.x + params[1], f * distorted.y + params[2]),
            d_point: perspective_chain(&(d_uv * f), &uv, inv_z),
            d_params,
        })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let distorted = Vector2::new(pixel.x - params[1], pixel.y - params[2]) / params[0];
        let uv = undistort(distorted, |uv| distort(params, uv))?;
        Some(uv.push(1.0).normalize())
    }
}
