//! OpenCV's perspective camera with a rational radial distortion.
//!
//! With (u, v) = (x/z, y/z), r² = u² + v² and
//! g = (1 + k₁ r² + k₂ r⁴ + k₃ r⁶)/(1 + k₄ r² + k₅ r⁴ + k₆ r⁶):
//! u' = g u + 2 p₁ u v + p₂ (r² + 2u²), v' = g v + 2 p₂ u v + p₁ (r² + 2v²), and the pixel is
//! (fx u' + cx, fy v' + cy).
//!
//! Source: OpenCV, module `calib3d`. Points at or beyond the pole of g do not project.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};

use super::model::{CameraModel, MIN_DEPTH, Projection, perspective_chain};
use super::undistort::undistort;

/// Two focal lengths, a rational radial distortion and decentring: fx, fy, cx, cy, k1, k2, p1, p2,
/// k3, k4, k5, k6.
#[derive(Clone, Copy, Debug, Default)]
pub struct FullOpencv;

type Params = SVector<f64, 12>;

/// The radial factor g, its derivative by r², and 1 over its denominator; `None` if the denominator
/// is not positive.
fn radial(params: &Params, r2: f64) -> Option<(f64, f64, f64)> {
    let [k1, k2, _, _, k3, k4, k5, k6] = std::array::from_fn(|i| params[4 + i]);
    let numerator = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    let denominator = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
    let d_numerator = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
    let d_denominator = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
    let inverse = 1.0 / denominator;
    let g = numerator * inverse;
    (denominator > 0.0).then_some((g, (d_numerator - g * d_denominator) * inverse, inverse))
}

/// The distorted point of the plane z = 1; `None` beyond the pole.
fn distort(params: &Params, uv: &Vector2<f64>) -> Option<Vector2<f64>> {
    let [p1, p2] = [params[6], params[7]];
    let (u, v, r2) = (uv.x, uv.y, uv.norm_squared());
    let (g, ..) = radial(params, r2)?;
    let cross = 2.0 * u * v;
    Some(Vector2::new(
        g * u + p1 * cross + p2 * (r2 + 2.0 * u * u),
        g * v + p2 * cross + p1 * (r2 + 2.0 * v * v),
    ))
}

/// The Jacobian of [`distort`] with respect to (u, v), which is symmetric.
fn d_distort(params: &Params, uv: &Vector2<f64>) -> Option<Matrix2<f64>> {
    let [p1, p2] = [params[6], params[7]];
    let (u, v) = (uv.x, uv.y);
    let (g, d_g, _) = radial(params, uv.norm_squared())?;
    let dg = 2.0 * d_g;
    let off_diagonal = dg * u * v + 2.0 * (p1 * u + p2 * v);
    Some(Matrix2::new(
        g + dg * u * u + 2.0 * p1 * v + 6.0 * p2 * u,
        off_diagonal,
        off_diagonal,
        g + dg * v * v + 2.0 * p2 * u + 6.0 * p1 * v,
    ))
}

impl CameraModel for FullOpencv {
    type Params = Params;
    const NAME: &'static str = "FULL_OPENCV";
    const COLMAP_ID: i32 = 6;
    const PARAM_NAMES: &'static [&'static str] =
        &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
    const FOCAL: &'static [usize] = &[0, 1];
    const PRINCIPAL_POINT: &'static [usize] = &[2, 3];

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        if point_in_cam.z < MIN_DEPTH {
            return None;
        }
        let distorted = distort(params, &(point_in_cam.xy() / point_in_cam.z))?;
        Some(Vector2::new(params[0] * distorted.x + params[2], params[1] * distorted.y + params[3]))
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
        let uv = point_in_cam.xy() * inv_z;
        let distorted = distort(params, &uv)?;
        let focal = Matrix2::new(fx, 0.0, 0.0, fy);
        let (u, v) = (uv.x, uv.y);
        let r2 = uv.norm_squared();
        let (g, _, inverse) = radial(params, r2)?;
        let cross = 2.0 * u * v;
        let d_k1 = focal * uv * (r2 * inverse);
        let (d_k2, d_k3) = (d_k1 * r2, d_k1 * (r2 * r2));
        let (d_k4, d_k5, d_k6) = (d_k1 * -g, d_k2 * -g, d_k3 * -g);
        #[rustfmt::skip]
        let d_params = SMatrix::<f64, 2, 12>::from_row_slice(&[
            distorted.x, 0.0, 1.0, 0.0, d_k1.x, d_k2.x,
            fx * cross, fx * (r2 + 2.0 * u * u), d_k3.x, d_k4.x, d_k5.x, d_k6.x,
            0.0, distorted.y, 0.0, 1.0, d_k1.y, d_k2.y,
            fy * (r2 + 2.0 * v * v), fy * cross, d_k3.y, d_k4.y, d_k5.y, d_k6.y,
        ]);
        Some(Projection {
            pixel: Vector2::new(fx * distorted.x + cx, fy * distorted.y + cy),
            d_point: perspective_chain(&(focal * d_distort(params, &uv)?), &uv, inv_z),
            d_params,
        })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let distorted =
            Vector2::new((pixel.x - params[2]) / params[0], (pixel.y - params[3]) / params[1]);
        // Beyond the pole, a Jacobian that is not positive definite keeps the search away.
        let uv = undistort(distorted, |uv| {
            let value = distort(params, uv).zip(d_distort(params, uv));
            value.unwrap_or((Vector2::zeros(), Matrix2::zeros()))
        })?;
        Some(uv.push(1.0).normalize())
    }
}
