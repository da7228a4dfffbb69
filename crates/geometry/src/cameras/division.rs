//! Cameras with the division model of distortion (Fitzgibbon 2001): the ray of the distorted point
//! (u, v) of the image plane is (u, v, 1 + k r²), r² = u² + v².
//!
//! The projection solves k ρ² s² − z s + 1 = 0 for (u, v) = s (x, y), ρ² = x² + y²: with d = √(z² −
//! 4 k ρ²), s = 2/(z + d). For barrel distortion, k < 0, the model images rays behind the camera;
//! for k > 0 it images rays up to ρ/z = 1/(2 √k), at r = 1/√k.

use nalgebra::{Matrix2x3, SMatrix, SVector, Vector2, Vector3};

use super::model::{CameraModel, MIN_DEPTH, Projection};

/// One focal length and one distortion coefficient: f, cx, cy, k.
#[derive(Clone, Copy, Debug, Default)]
pub struct SimpleDivision;

/// Two focal lengths and one distortion coefficient: fx, fy, cx, cy, k.
#[derive(Clone, Copy, Debug, Default)]
pub struct Division;

fn as_division(p: &SVector<f64, 4>) -> SVector<f64, 5> {
    SVector::<f64, 5>::new(p[0], p[0], p[1], p[2], p[3])
}

/// The scale s of (x, y) and the root d; `None` if the model does not image the point.
fn scale(k: f64, point_in_cam: &Vector3<f64>) -> Option<(f64, f64)> {
    let (rho2, z) = (point_in_cam.xy().norm_squared(), point_in_cam.z);
    let squared = z * z - 4.0 * k * rho2;
    if squared <= MIN_DEPTH * MIN_DEPTH {
        return None;
    }
    let root = squared.sqrt();
    if z >= 0.0 {
        return Some((2.0 / (z + root), root));
    }
    // The same quotient without cancellation of z + d. It is negative for k ≥ 0.
    let denominator = -2.0 * k * rho2;
    (denominator > MIN_DEPTH * MIN_DEPTH).then(|| ((root - z) / denominator, root))
}

impl CameraModel for SimpleDivision {
    type Params = SVector<f64, 4>;
    const NAME: &'static str = "SIMPLE_DIVISION";
    const COLMAP_ID: i32 = 12;
    const PARAM_NAMES: &'static [&'static str] = &["f", "cx", "cy", "k"];
    const FOCAL: &'static [usize] = &[0];
    const PRINCIPAL_POINT: &'static [usize] = &[1, 2];

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        Division::project(&as_division(params), point_in_cam)
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let Projection { pixel, d_point, d_params: d } =
            Division::project_with_jacobian(&as_division(params), point_in_cam)?;
        let d_params = SMatrix::<f64, 2, 4>::new(
            d[(0, 0)],
            1.0,
            0.0,
            d[(0, 4)],
            d[(1, 1)],
            0.0,
            1.0,
            d[(1, 4)],
        );
        Some(Projection { pixel, d_point, d_params })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        Division::unproject(&as_division(params), pixel)
    }
}

impl CameraModel for Division {
    type Params = SVector<f64, 5>;
    const NAME: &'static str = "DIVISION";
    const COLMAP_ID: i32 = 13;
    const PARAM_NAMES: &'static [&'static str] = &["fx", "fy", "cx", "cy", "k"];
    const FOCAL: &'static [usize] = &[0, 1];
    const PRINCIPAL_POINT: &'static [usize] = &[2, 3];

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        let (s, _) = scale(params[4], point_in_cam)?;
        let uv = point_in_cam.xy() * s;
        Some(Vector2::new(params[0] * uv.x + params[2], params[1] * uv.y + params[3]))
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let [fx, fy, cx, cy, k] = std::array::from_fn(|i| params[i]);
        let (s, root) = scale(k, point_in_cam)?;
        let (x, y) = (point_in_cam.x, point_in_cam.y);
        let rho2 = x * x + y * y;
        let (u, v) = (s * x, s * y);
        // Implicit differentiation of k ρ² s² − z s + 1 = 0, with 2 k ρ² s − z = −d:
        // ds/dk = ρ² s²/d, ds/dx = 2 k s² x/d, ds/dz = −s/d.
        let d_k = rho2 * s * s / root;
        let d_radius = 2.0 * k * s * s / root;
        let d_z = -s / root;
        let d_point = Matrix2x3::new(
            fx * (s + x * x * d_radius),
            fx * x * y * d_radius,
            fx * x * d_z,
            fy * x * y * d_radius,
            fy * (s + y * y * d_radius),
            fy * y * d_z,
        );
        let d_params = SMatrix::<f64, 2, 5>::from_row_slice(&[
            u,
            0.0,
            1.0,
            0.0,
            fx * x * d_k,
            0.0,
            v,
            0.0,
            1.0,
            fy * y * d_k,
        ]);
        Some(Projection { pixel: Vector2::new(fx * u + cx, fy * v + cy), d_point, d_params })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let (u, v) = ((pixel.x - params[2]) / params[0], (pixel.y - params[3]) / params[1]);
        let stretch = params[4] * (u * u + v * v);
        // Beyond r = 1/√k a ray has a second, smaller image.
        (stretch < 1.0).then(|| Vector3::new(u, v, 1.0 + stretch).normalize())
    }
}
