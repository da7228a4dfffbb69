//! The FOV camera (Devernay and Faugeras 2001, Eq. (13)): with r = √(x² + y²) and the angle ω, the
//! distorted radius is atan(2 tan(ω/2) r/z)/ω.
//!
//! That is the equidistant projection of the point p' = (a x, a y, z), a = 2 tan(ω/2), divided by
//! ω: with θ' the angle of p' to the optical axis and r' = a r, pixel = f · t · (θ'/r') · (x, y) +
//! c, where t = a/ω. In this form the projection is smooth on the axis and at ω = 0, and is defined
//! for z ≤ 0, where COLMAP's is not. COLMAP 4.2.1 replaces the formula by a truncated series for
//! r/z < 0.01, which differs by up to 3e-7 px (f = 1000 px, ω = 1.5), and for |ω| < 0.01 by the
//! series of the inverse, which differs by 0.05 px at r/z = 1 (f = 1000 px).

use nalgebra::{Matrix2, Matrix2x3, SMatrix, SVector, Vector2, Vector3};

use super::equidistant::{angle_over_radius, d_angle_over_radius, sinc};
use super::model::{CameraModel, Projection};

/// Two focal lengths and the angle ω, in radians: fx, fy, cx, cy, omega.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fov;

/// Below this |ω|, t' is computed by its series, whose neglected term is of order ω⁷ · 7e-4.
const SMALL_OMEGA: f64 = 0.03;

/// a, t = tan(ω/2)/(ω/2), and their derivatives by ω; `None` for |ω| ≥ π, where a is not defined.
fn stretch(omega: f64) -> Option<[f64; 4]> {
    if omega.abs() >= std::f64::consts::PI {
        return None;
    }
    let half = 0.5 * omega;
    let tangent = half.tan();
    let secant2 = 1.0 + tangent * tangent;
    let omega2 = omega * omega;
    let (t, d_t) = if omega.abs() < SMALL_OMEGA {
        (
            1.0 + omega2 * (1.0 / 12.0 + omega2 * (1.0 / 120.0 + omega2 * (17.0 / 20160.0))),
            omega * (1.0 / 6.0 + omega2 * (1.0 / 30.0 + omega2 * (17.0 / 3360.0))),
        )
    } else {
        (tangent / half, (secant2 * half - tangent) / (2.0 * half * half))
    };
    Some([2.0 * tangent, t, secant2, d_t])
}

impl CameraModel for Fov {
    type Params = SVector<f64, 5>;
    const NAME: &'static str = "FOV";
    const COLMAP_ID: i32 = 7;
    const PARAM_NAMES: &'static [&'static str] = &["fx", "fy", "cx", "cy", "omega"];
    const FOCAL: &'static [usize] = &[0, 1];
    const PRINCIPAL_POINT: &'static [usize] = &[2, 3];
    /// The projection is an even function of ω, whose derivative vanishes at zero.
    const INITIAL_DISTORTION: &'static [(usize, f64)] = &[(4, 1e-2)];

    fn project(params: &Self::Params, point_in_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        let [a, t, ..] = stretch(params[4])?;
        let xy = point_in_cam.xy();
        let uv = xy * (t * angle_over_radius(&(xy * a).push(point_in_cam.z))?);
        Some(Vector2::new(params[0] * uv.x + params[2], params[1] * uv.y + params[3]))
    }

    fn project_with_jacobian(
        params: &Self::Params,
        point_in_cam: &Vector3<f64>,
    ) -> Option<Projection<Self>> {
        let [fx, fy, cx, cy] = [params[0], params[1], params[2], params[3]];
        let [a, t, d_a, d_t] = stretch(params[4])?;
        let (xy, z) = (point_in_cam.xy(), point_in_cam.z);
        let stretched = (xy * a).push(z);
        let s = angle_over_radius(&stretched)?;
        // ds/dr' = c r' and ds/dz, where r' = a r.
        let (c, d_z) = d_angle_over_radius(&stretched, s);
        let r2 = xy.norm_squared();
        let focal = Matrix2::new(fx, 0.0, 0.0, fy);
        let uv = xy * (t * s);
        let d_xy = focal * (Matrix2::identity() * s + xy * xy.transpose() * (c * a * a)) * t;
        let d_omega = focal * xy * (t * c * a * d_a * r2 + d_t * s);
        let d_z = focal * xy * (t * d_z);
        let d_params = SMatrix::<f64, 2, 5>::from_row_slice(&[
            uv.x, 0.0, 1.0, 0.0, d_omega.x, 0.0, uv.y, 0.0, 1.0, d_omega.y,
        ]);
        Some(Projection {
            pixel: Vector2::new(fx * uv.x + cx, fy * uv.y + cy),
            d_point: Matrix2x3::from_columns(&[
                d_xy.column(0).into_owned(),
                d_xy.column(1).into_owned(),
                d_z,
            ]),
            d_params,
        })
    }

    fn unproject(params: &Self::Params, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let [_, t, ..] = stretch(params[4])?;
        let uv = Vector2::new((pixel.x - params[2]) / params[0], (pixel.y - params[3]) / params[1]);
        // The unit ray of p' is (ω uv sin θ'/θ', cos θ'), θ' = ω |uv|; x and y are over a = t ω.
        let angle = params[4].abs() * uv.norm();
        let is_unique = angle <= std::f64::consts::PI;
        is_unique.then(|| (uv * (sinc(angle) / t)).push(angle.cos()).normalize())
    }
}
