//! Equidistant fisheye cameras without distortion: pixel = f · θ (x, y)/r + c, where θ is the angle
//! to the optical axis. Unlike COLMAP's, they also project points with z ≤ 0.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};

use super::equidistant::{angle_over_radius, d_equidistant, ray};
use super::model::{CameraModel, Projection};

/// One focal length: f, cx, cy.
#[derive(Clone, Copy, Debug, Default)]
pub struct SimpleFisheye;

/// Two focal lengths: fx, fy, cx, cy.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fisheye;

fn as_fisheye(p: &SVector<f64, 3>) -> SVector<f64, 4> {
    SVector::<f64, 4>::new(p[0], p[0], p[1], p[2])
}

impl CameraModel for SimpleFisheye {
    type Params = SVector<f64, 3>;
    const NAME: &'static str = "SIMPLE_FISHEYE";
    const COLMAP_ID: i32 = 14;
    const PARAM_NAMES: &'static [&'static str] = &["f", "cx", "cy"];
    const FOCAL: &'static [usize] = &[0];
    const PRINCIPAL_POINT: &'static [usize] = &[1, 2];
    const IS_FISHEYE: bool = true;

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        Fisheye::project(&as_fisheye(params), point_in_cam)
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let Projection { pixel, d_point, d_params: d } =
            Fisheye::project_with_jacobian(&as_fisheye(params), point_in_cam)?;
        let d_params = SMatrix::<f64, 2, 3>::new(d[(0, 0)], 1.0, 0.0, d[(1, 1)], 0.0, 1.0);
        Some(Projection { pixel, d_point, d_params })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        Fisheye::unproject(&as_fisheye(params), pixel)
    }
}

impl CameraModel for Fisheye {
    type Params = SVector<f64, 4>;
    const NAME: &'static str = "FISHEYE";
    const COLMAP_ID: i32 = 15;
    const PARAM_NAMES: &'static [&'static str] = &["fx", "fy", "cx", "cy"];
    const FOCAL: &'static [usize] = &[0, 1];
    const PRINCIPAL_POINT: &'static [usize] = &[2, 3];
    const IS_FISHEYE: bool = true;

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        let w = point_in_cam.xy() * angle_over_radius(point_in_cam)?;
        Some(Vector2::new(params[0] * w.x + params[2], params[1] * w.y + params[3]))
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let scale = angle_over_radius(point_in_cam)?;
        let w = point_in_cam.xy() * scale;
        let [fx, fy, cx, cy] = [params[0], params[1], params[2], params[3]];
        Some(Projection {
            pixel: Vector2::new(fx * w.x + cx, fy * w.y + cy),
            d_point: Matrix2::new(fx, 0.0, 0.0, fy) * d_equidistant(point_in_cam, scale),
            d_params: SMatrix::<f64, 2, 4>::new(w.x, 0.0, 1.0, 0.0, 0.0, w.y, 0.0, 1.0),
        })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        ray(&Vector2::new((pixel.x - params[2]) / params[0], (pixel.y - params[3]) / params[1]))
    }
}
