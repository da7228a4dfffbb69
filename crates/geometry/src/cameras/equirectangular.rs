//! The spherical panorama of COLMAP: azimuth a = atan2(x, z) and elevation e = atan2(−y, √(x² +
//! z²)) are linear in the pixel, ((a/2π + 1/2) w, (1/2 − e/π) h). Each direction is imaged.
//!
//! The image is periodic in x: residuals go the shorter way around. The horizontal scale grows as
//! 1/cos e towards the poles; thresholds are therefore compared with the angle between the rays,
//! in pixels at the equator, as in COLMAP (`CalculateSquaredReprojectionError`).

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix2, Matrix2x3, SVector, Vector2, Vector3};

use super::model::{CameraModel, MIN_DEPTH, Projection};

/// The width and height of the image: w, h. There is neither a focal length nor a principal point.
#[derive(Clone, Copy, Debug, Default)]
pub struct Equirectangular;

impl CameraModel for Equirectangular {
    type Params = SVector<f64, 2>;
    const NAME: &'static str = "EQUIRECTANGULAR";
    const COLMAP_ID: i32 = 17;
    const PARAM_NAMES: &'static [&'static str] = &["w", "h"];
    const FOCAL: &'static [usize] = &[];
    const PRINCIPAL_POINT: &'static [usize] = &[];
    const METADATA: &'static [usize] = &[0, 1];

    /// The poles are imaged at azimuth zero.
    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        let [x, y, z] = [point_in_cam.x, point_in_cam.y, point_in_cam.z];
        let horizontal = x.hypot(z);
        if horizontal + y.abs() < MIN_DEPTH {
            return None;
        }
        let (azimuth, elevation) = (x.atan2(z), (-y).atan2(horizontal));
        Some(Vector2::new((azimuth / TAU + 0.5) * params[0], (0.5 - elevation / PI) * params[1]))
    }

    /// `None` at the poles, where the azimuth has no derivative.
    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let pixel = Self::project(params, point_in_cam)?;
        let [x, y, z] = [point_in_cam.x, point_in_cam.y, point_in_cam.z];
        let horizontal2 = x * x + z * z;
        if horizontal2 < MIN_DEPTH * MIN_DEPTH {
            return None;
        }
        let horizontal = horizontal2.sqrt();
        let by_azimuth = params[0] / (TAU * horizontal2);
        let by_elevation = params[1] / (PI * (horizontal2 + y * y));
        Some(Projection {
            pixel,
            d_point: Matrix2x3::new(
                by_azimuth * z,
                0.0,
                -by_azimuth * x,
                -by_elevation * x * y / horizontal,
                by_elevation * horizontal,
                -by_elevation * y * z / horizontal,
            ),
            d_params: Matrix2::new(pixel.x / params[0], 0.0, 0.0, pixel.y / params[1]),
        })
    }

    /// `None` above and below the image. To the left and right it repeats.
    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let azimuth = TAU * (pixel.x / params[0] - 0.5);
        let elevation = PI * (0.5 - pixel.y / params[1]);
        let horizontal = elevation.cos();
        (0.0..=params[1]).contains(&pixel.y).then(|| {
            Vector3::new(horizontal * azimuth.sin(), -elevation.sin(), horizontal * azimuth.cos())
        })
    }

    fn focal_lengths_px(params: &Self::Params) -> [f64; 2] {
        [params[0] / TAU, params[1] / PI]
    }

    fn principal_point(params: &Self::Params) -> Vector2<f64> {
        params * 0.5
    }

    fn displacement(
        params: &Self::Params,
        projected: &Vector2<f64>,
        observed: &Vector2<f64>,
    ) -> Vector2<f64> {
        let mut displacement = projected - observed;
        displacement.x -= params[0] * (displacement.x / params[0]).round();
        displacement
    }

    fn squared_error_px2(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
        observed: &Vector2<f64>,
    ) -> Option<f64> {
        let ray = Self::unproject(params, observed)?;
        Self::project(params, point_in_cam)?;
        let angle = ray.cross(point_in_cam).norm().atan2(ray.dot(point_in_cam));
        Some((angle * params[0] / TAU).powi(2))
    }
}
