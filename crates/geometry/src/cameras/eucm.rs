//! The enhanced unified camera model (Khomutenko, Garcia and Martinet 2016, Eq. (10)): with d =
//! √(β (x² + y²) + z²), pixel = f · (x, y)/(α d + (1 − α) z) + c, 0 ≤ α ≤ 1, β > 0.
//!
//! The model images all rays with z > −m d, m = min(α/(1 − α), (1 − α)/α): for α > 0 also rays
//! behind the image plane, where COLMAP's does not.

use nalgebra::{Matrix2x3, SMatrix, SVector, Vector2, Vector3};

use super::model::{CameraModel, MIN_DEPTH, Projection};

/// Two focal lengths and the shape of the projection surface: fx, fy, cx, cy, alpha, beta.
#[derive(Clone, Copy, Debug, Default)]
pub struct Eucm;

type Params = SVector<f64, 6>;

/// The distance d and the denominator; `None` if the model does not image the point.
fn denominator(params: &Params, point_in_cam: &Vector3<f64>) -> Option<(f64, f64)> {
    let [alpha, beta] = [params[4], params[5]];
    let z = point_in_cam.z;
    let squared = beta * point_in_cam.xy().norm_squared() + z * z;
    if squared <= MIN_DEPTH * MIN_DEPTH {
        return None;
    }
    let distance = squared.sqrt();
    let denominator = alpha * distance + (1.0 - alpha) * z;
    // For α > 1/2, images fold back where d/dz of the denominator vanishes: α z + (1 − α) d = 0.
    let is_before_fold = alpha * z + (1.0 - alpha) * distance > 0.0;
    (denominator > MIN_DEPTH && is_before_fold).then_some((distance, denominator))
}

/// Difference of a denominator from 1 by rounding; another branch differs by more.
const BRANCH_TOLERANCE: f64 = 1e-9;

impl CameraModel for Eucm {
    type Params = Params;
    const NAME: &'static str = "EUCM";
    const COLMAP_ID: i32 = 16;
    const PARAM_NAMES: &'static [&'static str] = &["fx", "fy", "cx", "cy", "alpha", "beta"];
    const FOCAL: &'static [usize] = &[0, 1];
    const PRINCIPAL_POINT: &'static [usize] = &[2, 3];
    const INITIAL_DISTORTION: &'static [(usize, f64)] = &[(5, 1.0)];

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        let (_, denominator) = denominator(params, point_in_cam)?;
        let uv = point_in_cam.xy() / denominator;
        Some(Vector2::new(params[0] * uv.x + params[2], params[1] * uv.y + params[3]))
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let [fx, fy, cx, cy, alpha, beta] = std::array::from_fn(|i| params[i]);
        let (distance, denominator) = denominator(params, point_in_cam)?;
        let (xy, z) = (point_in_cam.xy(), point_in_cam.z);
        let inverse = 1.0 / denominator;
        let uv = xy * inverse;
        let (scaled_u, scaled_v) = (fx * uv.x, fy * uv.y);
        // Derivatives of the logarithm of the denominator.
        let d_xy = xy * (alpha * beta / distance * inverse);
        let d_z = (alpha * z / distance + 1.0 - alpha) * inverse;
        let d_alpha = (distance - z) * inverse;
        let d_beta = 0.5 * alpha * xy.norm_squared() / distance * inverse;
        let d_point = Matrix2x3::new(
            fx * inverse - scaled_u * d_xy.x,
            -scaled_u * d_xy.y,
            -scaled_u * d_z,
            -scaled_v * d_xy.x,
            fy * inverse - scaled_v * d_xy.y,
            -scaled_v * d_z,
        );
        #[rustfmt::skip]
        let d_params = SMatrix::<f64, 2, 6>::from_row_slice(&[
            uv.x, 0.0, 1.0, 0.0, -scaled_u * d_alpha, -scaled_u * d_beta,
            0.0, uv.y, 0.0, 1.0, -scaled_v * d_alpha, -scaled_v * d_beta,
        ]);
        let pixel = Vector2::new(scaled_u + cx, scaled_v + cy);
        Some(Projection { pixel, d_point, d_params })
    }

    /// Eq. (24) of the paper.
    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let [alpha, beta] = [params[4], params[5]];
        let uv = Vector2::new((pixel.x - params[2]) / params[0], (pixel.y - params[3]) / params[1]);
        let stretched = beta * uv.norm_squared();
        let radicand = 1.0 - (2.0 * alpha - 1.0) * stretched;
        let denominator = alpha * radicand.max(0.0).sqrt() + 1.0 - alpha;
        if radicand < 0.0 || denominator <= 0.0 {
            return None;
        }
        let ray = uv.push((1.0 - alpha * alpha * stretched) / denominator);
        // Of a ray whose x and y are those of `uv` the denominator is 1. For parameters outside of
        // their range, the ray may be on another branch.
        let (_, of_ray) = self::denominator(params, &ray)?;
        ((of_ray - 1.0).abs() < BRANCH_TOLERANCE).then(|| ray.normalize())
    }
}
