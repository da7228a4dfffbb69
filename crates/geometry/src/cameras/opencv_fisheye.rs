//! OpenCV's fisheye camera (Kannala and Brandt 2006): with θ the angle to the optical axis and r
//! = √(x² + y²), θ_d = θ (1 + k₁ θ² + k₂ θ⁴ + k₃ θ⁶ + k₄ θ⁸), pixel = (fx θ_d x/r + cx, fy θ_d y/r
//! + cy).
//!
//! The projection is computed in two steps, which are smooth on the optical axis: the equidistant
//! point w = θ (x, y)/r, then a radial polynomial of w. Unlike OpenCV and COLMAP, this model also
//! projects points with z ≤ 0, if θ_d increases with θ there.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};

use super::equidistant::{angle_over_radius, d_equidistant, ray};
use super::model::{CameraModel, Projection};
use super::undistort::undistort;

/// Two focal lengths and a polynomial of θ: fx, fy, cx, cy, k1, k2, k3, k4.
#[derive(Clone, Copy, Debug, Default)]
pub struct OpencvFisheye;

/// θ_d/θ.
fn factor(params: &SVector<f64, 8>, angle2: f64) -> f64 {
    1.0 + angle2 * (params[4] + angle2 * (params[5] + angle2 * (params[6] + angle2 * params[7])))
}

/// dθ_d/dθ.
fn d_angle(params: &SVector<f64, 8>, angle2: f64) -> f64 {
    let [k1, k2, k3, k4] = [params[4], params[5], params[6], params[7]];
    1.0 + angle2 * (3.0 * k1 + angle2 * (5.0 * k2 + angle2 * (7.0 * k3 + angle2 * 9.0 * k4)))
}

/// The distorted point of the equidistant plane and its derivative.
fn distort(params: &SVector<f64, 8>, w: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
    let [k1, k2, k3, k4] = [params[4], params[5], params[6], params[7]];
    let angle2 = w.norm_squared();
    let factor = factor(params, angle2);
    let d_factor = 2.0 * (k1 + angle2 * (2.0 * k2 + angle2 * (3.0 * k3 + angle2 * 4.0 * k4)));
    (w * factor, Matrix2::identity() * factor + w * w.transpose() * d_factor)
}

/// The equidistant point w and θ/r; `None` if the model does not project the point.
fn equidistant(
    params: &SVector<f64, 8>,
    point_in_cam: &Vector3<f64>,
) -> Option<(Vector2<f64>, f64)> {
    let scale = angle_over_radius(point_in_cam)?;
    let w = point_in_cam.xy() * scale;
    (point_in_cam.z > 0.0 || d_angle(params, w.norm_squared()) > 0.0).then_some((w, scale))
}

impl CameraModel for OpencvFisheye {
    type Params = SVector<f64, 8>;
    const NAME: &'static str = "OPENCV_FISHEYE";
    const COLMAP_ID: i32 = 5;
    const PARAM_NAMES: &'static [&'static str] = &["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"];
    const FOCAL: &'static [usize] = &[0, 1];
    const PRINCIPAL_POINT: &'static [usize] = &[2, 3];
    const IS_FISHEYE: bool = true;

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        let (w, _) = equidistant(params, point_in_cam)?;
        let distorted = w * factor(params, w.norm_squared());
        Some(Vector2::new(params[0] * distorted.x + params[2], params[1] * distorted.y + params[3]))
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let (w, scale) = equidistant(params, point_in_cam)?;
        let [fx, fy, cx, cy] = [params[0], params[1], params[2], params[3]];
        let (distorted, d_w) = distort(params, &w);
        let focal = Matrix2::new(fx, 0.0, 0.0, fy);
        let angle2 = w.norm_squared();
        let d_k1 = focal * w * angle2;
        let d_k2 = d_k1 * angle2;
        let d_k3 = d_k2 * angle2;
        let d_k4 = d_k3 * angle2;
        #[rustfmt::skip]
        let d_params = SMatrix::<f64, 2, 8>::from_row_slice(&[
            distorted.x, 0.0, 1.0, 0.0, d_k1.x, d_k2.x, d_k3.x, d_k4.x,
            0.0, distorted.y, 0.0, 1.0, d_k1.y, d_k2.y, d_k3.y, d_k4.y,
        ]);
        Some(Projection {
            pixel: Vector2::new(fx * distorted.x + cx, fy * distorted.y + cy),
            d_point: focal * d_w * d_equidistant(point_in_cam, scale),
            d_params,
        })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let distorted =
            Vector2::new((pixel.x - params[2]) / params[0], (pixel.y - params[3]) / params[1]);
        ray(&undistort(distorted, |w| distort(params, w))?)
    }
}
