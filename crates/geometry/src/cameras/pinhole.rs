//! Perspective cameras without distortion: pixel = f · (x/z, y/z) + c.

use nalgebra::{Matrix2x3, Matrix2x4, SVector, Vector2, Vector3};

use super::model::{CameraModel, MIN_DEPTH, Projection};

/// One focal length: f, cx, cy.
#[derive(Clone, Copy, Debug, Default)]
pub struct SimplePinhole;

/// Two focal lengths: fx, fy, cx, cy.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pinhole;

impl CameraModel for SimplePinhole {
    type Params = SVector<f64, 3>;
    const NAME: &'static str = "SIMPLE_PINHOLE";
    const COLMAP_ID: i32 = 0;
    const PARAM_NAMES: &'static [&'static str] = &["f", "cx", "cy"];
    const FOCAL: &'static [usize] = &[0];
    const PRINCIPAL_POINT: &'static [usize] = &[1, 2];

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        Pinhole::project(
            &SVector::<f64, 4>::new(params[0], params[0], params[1], params[2]),
            point_in_cam,
        )
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let pinhole = SVector::<f64, 4>::new(params[0], params[0], params[1], params[2]);
        let Projection { pixel, d_point, d_params: d } =
            Pinhole::project_with_jacobian(&pinhole, point_in_cam)?;
        let d_params = Matrix2x3::new(d[(0, 0)], 1.0, 0.0, d[(1, 1)], 0.0, 1.0);
        Some(Projection { pixel, d_point, d_params })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        Pinhole::unproject(
            &SVector::<f64, 4>::new(params[0], params[0], params[1], params[2]),
            pixel,
        )
    }
}

impl CameraModel for Pinhole {
    type Params = SVector<f64, 4>;
    const NAME: &'static str = "PINHOLE";
    const COLMAP_ID: i32 = 1;
    const PARAM_NAMES: &'static [&'static str] = &["fx", "fy", "cx", "cy"];
    const FOCAL: &'static [usize] = &[0, 1];
    const PRINCIPAL_POINT: &'static [usize] = &[2, 3];

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        if point_in_cam.z < MIN_DEPTH {
            return None;
        }
        let (u, v) = (point_in_cam.x / point_in_cam.z, point_in_cam.y / point_in_cam.z);
        Some(Vector2::new(params[0] * u + params[2], params[1] * v + params[3]))
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        if point_in_cam.z < MIN_DEPTH {
            return None;
        }
        let [fx, fy, cx, cy] = [params[0], params[1], params[2], params[3]];
        let inv_z = 1.0 / point_in_cam.z;
        let (u, v) = (point_in_cam.x * inv_z, point_in_cam.y * inv_z);
        let d_point =
            Matrix2x3::new(fx * inv_z, 0.0, -fx * u * inv_z, 0.0, fy * inv_z, -fy * v * inv_z);
        let d_params = Matrix2x4::new(u, 0.0, 1.0, 0.0, 0.0, v, 0.0, 1.0);
        Some(Projection { pixel: Vector2::new(fx * u + cx, fy * v + cy), d_point, d_params })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        Some(
            Vector3::new((pixel.x - params[2]) / params[0], (pixel.y - params[3]) / params[1], 1.0)
                .normalize(),
        )
    }
}
