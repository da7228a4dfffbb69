//! COLMAP's fisheye camera with decentring and thin prism distortion (Weng, Cohen and Herniou
//! 1992). With w = (u, v) the equidistant point, ρ² = u² + v² = θ² and
//! g = 1 + k₁ ρ² + k₂ ρ⁴ + k₃ ρ⁶ + k₄ ρ⁸:
//!
//! - u' = g u + 2 p₁ u v + p₂ (ρ² + 2u²) + s₁ ρ²,
//! - v' = g v + 2 p₂ u v + p₁ (ρ² + 2v²) + s₂ ρ²,
//! - pixel = (fx u' + cx, fy v' + cy).
//!
//! The prism coefficients are nearly unobservable if poses are unknown. A rotation of the camera by
//! ε about x changes v by ε (1 − u²/3) and u by ε uv/3, up to the fourth order of ρ. The lens
//! reproduces the change by a shift of cy by fy ε, p₁ = ε (1/6 + k₁) and s₂ = −ε/2. The same holds
//! for a rotation about y with cx, p₂ and s₁.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};

use super::equidistant::{angle_over_radius, d_equidistant, ray};
use super::model::{CameraModel, Projection};
use super::undistort::undistort;

/// Two focal lengths, a polynomial of θ, decentring and a thin prism: fx, fy, cx, cy, k1,
/// k2, p1, p2, k3, k4, sx1, sy1.
#[derive(Clone, Copy, Debug, Default)]
pub struct ThinPrismFisheye;

type Params = SVector<f64, 12>;

/// dθ_d/dθ of the radial part.
fn d_angle(params: &Params, angle2: f64) -> f64 {
    let [k1, k2, k3, k4] = [params[4], params[5], params[8], params[9]];
    1.0 + angle2 * (3.0 * k1 + angle2 * (5.0 * k2 + angle2 * (7.0 * k3 + angle2 * 9.0 * k4)))
}

/// The distorted point of the equidistant plane.
fn distort(params: &Params, w: &Vector2<f64>) -> Vector2<f64> {
    let [k1, k2, p1, p2, k3, k4, s1, s2] = std::array::from_fn(|i| params[4 + i]);
    let (u, v) = (w.x, w.y);
    let rho2 = w.norm_squared();
    let g = 1.0 + rho2 * (k1 + rho2 * (k2 + rho2 * (k3 + rho2 * k4)));
    let cross = 2.0 * u * v;
    Vector2::new(
        g * u + p1 * cross + p2 * (rho2 + 2.0 * u * u) + s1 * rho2,
        g * v + p2 * cross + p1 * (rho2 + 2.0 * v * v) + s2 * rho2,
    )
}

/// The Jacobian of [`distort`] with respect to w.
fn d_distort(params: &Params, w: &Vector2<f64>) -> Matrix2<f64> {
    let [k1, k2, p1, p2, k3, k4, s1, s2] = std::array::from_fn(|i| params[4 + i]);
    let (u, v) = (w.x, w.y);
    let rho2 = w.norm_squared();
    let g = 1.0 + rho2 * (k1 + rho2 * (k2 + rho2 * (k3 + rho2 * k4)));
    let dg = 2.0 * (k1 + rho2 * (2.0 * k2 + rho2 * (3.0 * k3 + rho2 * 4.0 * k4)));
    let off_diagonal = dg * u * v + 2.0 * (p1 * u + p2 * v);
    Matrix2::new(
        g + dg * u * u + 2.0 * p1 * v + 6.0 * p2 * u + 2.0 * s1 * u,
        off_diagonal + 2.0 * s1 * v,
        off_diagonal + 2.0 * s2 * u,
        g + dg * v * v + 2.0 * p2 * u + 6.0 * p1 * v + 2.0 * s2 * v,
    )
}

/// The equidistant point w and θ/r; `None` if the model does not project the point.
fn equidistant(params: &Params, point_in_cam: &Vector3<f64>) -> Option<(Vector2<f64>, f64)> {
    let scale = angle_over_radius(point_in_cam)?;
    let w = point_in_cam.xy() * scale;
    (point_in_cam.z > 0.0 || d_angle(params, w.norm_squared()) > 0.0).then_some((w, scale))
}

impl CameraModel for ThinPrismFisheye {
    type Params = Params;
    const NAME: &'static str = "THIN_PRISM_FISHEYE";
    const COLMAP_ID: i32 = 10;
    const PARAM_NAMES: &'static [&'static str] =
        &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"];
    const FOCAL: &'static [usize] = &[0, 1];
    const PRINCIPAL_POINT: &'static [usize] = &[2, 3];
    const IS_FISHEYE: bool = true;
    const ROTATION_DEGENERATE: &'static [usize] = &[10, 11];

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        let (w, _) = equidistant(params, point_in_cam)?;
        let distorted = distort(params, &w);
        Some(Vector2::new(params[0] * distorted.x + params[2], params[1] * distorted.y + params[3]))
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let (w, scale) = equidistant(params, point_in_cam)?;
        let [fx, fy, cx, cy] = [params[0], params[1], params[2], params[3]];
        let distorted = distort(params, &w);
        let focal = Matrix2::new(fx, 0.0, 0.0, fy);
        let (u, v) = (w.x, w.y);
        let rho2 = w.norm_squared();
        let cross = 2.0 * u * v;
        let d_k1 = focal * w * rho2;
        let d_k2 = d_k1 * rho2;
        let d_k3 = d_k2 * rho2;
        let d_k4 = d_k3 * rho2;
        let (d_p1, d_p2) =
            ((fx * cross, fy * (rho2 + 2.0 * v * v)), (fx * (rho2 + 2.0 * u * u), fy * cross));
        #[rustfmt::skip]
        let d_params = SMatrix::<f64, 2, 12>::from_row_slice(&[
            distorted.x, 0.0, 1.0, 0.0, d_k1.x, d_k2.x, d_p1.0, d_p2.0, d_k3.x,
            d_k4.x, fx * rho2, 0.0,
            0.0, distorted.y, 0.0, 1.0, d_k1.y, d_k2.y, d_p1.1, d_p2.1, d_k3.y,
            d_k4.y, 0.0, fy * rho2,
        ]);
        Some(Projection {
            pixel: Vector2::new(fx * distorted.x + cx, fy * distorted.y + cy),
            d_point: focal * d_distort(params, &w) * d_equidistant(point_in_cam, scale),
            d_params,
        })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let distorted =
            Vector2::new((pixel.x - params[2]) / params[0], (pixel.y - params[3]) / params[1]);
        ray(&undistort(distorted, |w| (distort(params, w), d_distort(params, w)))?)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;

    use super::*;

    /// Rotation angle in radians; its square is negligible.
    const ROTATION_RAD: f64 = 1e-6;
    /// Bound on the difference between rotation and lens at ρ = 1, relative to the rotation. It is
    /// proportional to ρ⁴; its largest term is 5 k₂, the others are hundredths.
    const MAX_DIFFERENCE: f64 = 0.3;
    const K: [f64; 2] = [0.03, -0.05];

    #[test]
    fn prism_is_degenerate_with_a_rotation_up_to_the_fourth_order() {
        let lens = |shift: Vector2<f64>| {
            let [p2, p1] = [shift.x, shift.y].map(|rotation| rotation * (1.0 / 6.0 + K[0]));
            let prism = shift * -0.5;
            let shifted = shift * 500.0;
            SVector::from([
                500.0, 500.0, shifted.x, shifted.y, K[0], K[1], p1, p2, 0.0, 0.0, prism.x, prism.y,
            ])
        };
        for (axis, shift) in
            [(Vector3::x(), Vector2::new(0.0, -1.0)), (Vector3::y(), Vector2::new(1.0, 0.0))]
        {
            for (rho, azimuth) in [0.05, 0.1, 0.3]
                .into_iter()
                .flat_map(|rho| (0..8).map(move |k| (rho, f64::from(k))))
            {
                let w = Vector2::new(azimuth.cos(), azimuth.sin()) * rho;
                let rotated_ray =
                    Rotation3::from_scaled_axis(axis * ROTATION_RAD) * ray(&w).unwrap();
                let by_rotation =
                    ThinPrismFisheye::project(&lens(Vector2::zeros()), &rotated_ray).unwrap();
                let by_lens =
                    ThinPrismFisheye::project(&lens(shift * ROTATION_RAD), &ray(&w).unwrap())
                        .unwrap();
                let difference = (by_rotation - by_lens).norm() / (500.0 * ROTATION_RAD);
                assert!(
                    difference < MAX_DIFFERENCE * rho.powi(4) + 1e-5,
                    "{difference} at {w}, about {axis}"
                );
            }
        }
    }
}
