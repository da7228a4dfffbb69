//! The fisheye camera of Project Aria, "Fisheye624", in COLMAP's parameter order. With w the
//! equidistant point, |w| = θ, x = (1 + Σ kᵢ θ^(2i+2)) w, i = 0 … 5, and r² = |x|²:
//!
//! - x' = x + 2 p₁ x y + p₀ (r² + 2x²) + s₀ r² + s₁ r⁴,
//! - y' = y + 2 p₀ x y + p₁ (r² + 2y²) + s₂ r² + s₃ r⁴,
//! - pixel = (fx x' + cx, fy y' + cy).
//!
//! Decentring and prism act on the radially distorted point, unlike in
//! [`ThinPrismFisheye`](super::ThinPrismFisheye). Source: Project Aria, "Camera intrinsic models".

use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};

use super::equidistant::{angle_over_radius, d_equidistant, ray};
use super::model::{CameraModel, Projection};
use super::undistort::undistort;

/// Two focal lengths, a polynomial of θ, decentring and a thin prism: fx, fy, cx, cy, k0 … k5, p0,
/// p1, s0 … s3.
#[derive(Clone, Copy, Debug, Default)]
pub struct RadTanThinPrismFisheye;

type Params = SVector<f64, 16>;

/// Index of k0.
const RADIAL: usize = 4;

/// θ_d/θ and dθ_d/dθ.
fn radial(params: &Params, angle2: f64) -> (f64, f64) {
    let (mut factor, mut slope) = (0.0, 0.0);
    for i in (0..6).rev() {
        let k = params[RADIAL + i];
        factor = angle2 * (k + factor);
        slope = angle2 * ((2 * i + 3) as f64 * k + slope);
    }
    (1.0 + factor, 1.0 + slope)
}

/// The radially distorted point and its derivative by w.
fn distort_radially(params: &Params, w: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
    let angle2 = w.norm_squared();
    // d(θ_d/θ)/d(θ²).
    let d_factor =
        (0..6).rev().fold(0.0, |sum, i| sum * angle2 + (i + 1) as f64 * params[RADIAL + i]);
    let (factor, _) = radial(params, angle2);
    (w * factor, Matrix2::identity() * factor + w * w.transpose() * (2.0 * d_factor))
}

/// The decentred point and its derivative by x.
fn decentre(params: &Params, x: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
    let [p0, p1, s0, s1, s2, s3] = std::array::from_fn(|i| params[10 + i]);
    let (u, v, r2) = (x.x, x.y, x.norm_squared());
    let cross = 2.0 * u * v;
    let value = Vector2::new(
        u + p1 * cross + p0 * (r2 + 2.0 * u * u) + r2 * (s0 + s1 * r2),
        v + p0 * cross + p1 * (r2 + 2.0 * v * v) + r2 * (s2 + s3 * r2),
    );
    // d(s r² + s' r⁴)/du = 2u (s + 2 s' r²).
    let (prism_x, prism_y) = (2.0 * (s0 + 2.0 * s1 * r2), 2.0 * (s2 + 2.0 * s3 * r2));
    let off_diagonal = 2.0 * (p1 * u + p0 * v);
    let derivative = Matrix2::new(
        1.0 + 2.0 * p1 * v + 6.0 * p0 * u + prism_x * u,
        off_diagonal + prism_x * v,
        off_diagonal + prism_y * u,
        1.0 + 2.0 * p0 * u + 6.0 * p1 * v + prism_y * v,
    );
    (value, derivative)
}

/// The equidistant point w and θ/r; `None` if the model does not project the point.
fn equidistant(params: &Params, point_in_cam: &Vector3<f64>) -> Option<(Vector2<f64>, f64)> {
    let scale = angle_over_radius(point_in_cam)?;
    let w = point_in_cam.xy() * scale;
    (point_in_cam.z > 0.0 || radial(params, w.norm_squared()).1 > 0.0).then_some((w, scale))
}

impl CameraModel for RadTanThinPrismFisheye {
    type Params = Params;
    const NAME: &'static str = "RAD_TAN_THIN_PRISM_FISHEYE";
    const COLMAP_ID: i32 = 11;
    const PARAM_NAMES: &'static [&'static str] = &[
        "fx", "fy", "cx", "cy", "k0", "k1", "k2", "k3", "k4", "k5", "p0", "p1", "s0", "s1", "s2",
        "s3",
    ];
    const FOCAL: &'static [usize] = &[0, 1];
    const PRINCIPAL_POINT: &'static [usize] = &[2, 3];
    const IS_FISHEYE: bool = true;
    const ROTATION_DEGENERATE: &'static [usize] = &[12, 14];

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        let (w, _) = equidistant(params, point_in_cam)?;
        let (x, _) = distort_radially(params, &w);
        let (distorted, _) = decentre(params, &x);
        Some(Vector2::new(params[0] * distorted.x + params[2], params[1] * distorted.y + params[3]))
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let (w, scale) = equidistant(params, point_in_cam)?;
        let [fx, fy, cx, cy] = [params[0], params[1], params[2], params[3]];
        let (x, d_w) = distort_radially(params, &w);
        let (distorted, d_x) = decentre(params, &x);
        let focal = Matrix2::new(fx, 0.0, 0.0, fy);
        let d_x = focal * d_x;
        let (u, v, r2) = (x.x, x.y, x.norm_squared());
        let cross = 2.0 * u * v;
        let mut d_params = SMatrix::<f64, 2, 16>::zeros();
        d_params[(0, 0)] = distorted.x;
        d_params[(1, 1)] = distorted.y;
        d_params[(0, 2)] = 1.0;
        d_params[(1, 3)] = 1.0;
        let mut d_k = d_x * w;
        for i in 0..6 {
            d_k *= w.norm_squared();
            d_params.set_column(RADIAL + i, &d_k);
        }
        d_params.set_column(10, &Vector2::new(fx * (r2 + 2.0 * u * u), fy * cross));
        d_params.set_column(11, &Vector2::new(fx * cross, fy * (r2 + 2.0 * v * v)));
        d_params[(0, 12)] = fx * r2;
        d_params[(0, 13)] = fx * r2 * r2;
        d_params[(1, 14)] = fy * r2;
        d_params[(1, 15)] = fy * r2 * r2;
        Some(Projection {
            pixel: Vector2::new(fx * distorted.x + cx, fy * distorted.y + cy),
            d_point: d_x * d_w * d_equidistant(point_in_cam, scale),
            d_params,
        })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let distorted =
            Vector2::new((pixel.x - params[2]) / params[0], (pixel.y - params[3]) / params[1]);
        let x = undistort(distorted, |x| decentre(params, x))?;
        ray(&undistort(x, |w| distort_radially(params, w))?)
    }
}
