//! The equidistant projection w = θ (x, y)/r, to which fisheye models apply distortion: θ is the
//! angle to the optical axis and r = √(x² + y²). It is smooth on the axis and defined behind the
//! camera.

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

use super::model::MIN_DEPTH;

/// Below this squared tangent of θ, functions of θ are replaced by their series; the neglected
/// terms are of order tan⁴ θ ≤ 1e-16.
const SMALL_TAN2: f64 = 1e-8;

/// θ/r, with w = (x, y) · θ/r; `None` at the camera centre and on the optical axis behind it.
pub(super) fn angle_over_radius(point_in_cam: &Vector3<f64>) -> Option<f64> {
    let (r2, z) = (point_in_cam.xy().norm_squared(), point_in_cam.z);
    if z > MIN_DEPTH && r2 < SMALL_TAN2 * z * z {
        return Some((1.0 - r2 / (3.0 * z * z)) / z);
    }
    let r = r2.sqrt();
    (r > MIN_DEPTH).then(|| r.atan2(z) / r)
}

/// The derivatives of θ/r: (d(θ/r)/dr)/r = (z/(r² + z²) − θ/r)/r², and d(θ/r)/dz = −1/(r² + z²).
pub(super) fn d_angle_over_radius(
    point_in_cam: &Vector3<f64>,
    angle_over_radius: f64,
) -> (f64, f64) {
    let (r2, z) = (point_in_cam.xy().norm_squared(), point_in_cam.z);
    let inv_norm2 = 1.0 / (r2 + z * z);
    let by_radius = if z > MIN_DEPTH && r2 < SMALL_TAN2 * z * z {
        (-2.0 / 3.0 + 0.8 * r2 / (z * z)) / (z * z * z)
    } else {
        (z * inv_norm2 - angle_over_radius) / r2
    };
    (by_radius, -inv_norm2)
}

/// dw / d point.
pub(super) fn d_equidistant(point_in_cam: &Vector3<f64>, angle_over_radius: f64) -> Matrix2x3<f64> {
    let xy = point_in_cam.xy();
    let (by_radius, by_z) = d_angle_over_radius(point_in_cam, angle_over_radius);
    let d_xy = Matrix2::identity() * angle_over_radius + xy * xy.transpose() * by_radius;
    let d_z = xy * by_z;
    Matrix2x3::from_columns(&[d_xy.column(0).into_owned(), d_xy.column(1).into_owned(), d_z])
}

/// The unit ray of w; `None` if |w| > π.
pub(super) fn ray(w: &Vector2<f64>) -> Option<Vector3<f64>> {
    let angle = w.norm();
    if angle > std::f64::consts::PI {
        return None;
    }
    Some((w * sinc(angle)).push(angle.cos()))
}

/// sin θ / θ, by its series near zero.
pub(super) fn sinc(angle: f64) -> f64 {
    if angle * angle < SMALL_TAN2 { 1.0 - angle * angle / 6.0 } else { angle.sin() / angle }
}
