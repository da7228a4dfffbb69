//! The rotation group: exponential, logarithm and their derivatives (Solà, Deray, Atchuthan 2018,
//! "A micro Lie theory").

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Below this angle (radians) the trigonometric coefficients are replaced by their series; the
/// first neglected term is of order θ⁴ ≈ 1e-16.
const SMALL_ANGLE: f64 = 1e-4;

/// The cross-product matrix: `hat(a) * b == a.cross(b)`.
pub fn hat(a: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -a.z, a.y, a.z, 0.0, -a.x, -a.y, a.x, 0.0)
}

/// The rotation by the axis-angle vector `w` (radians).
pub fn exp(w: &Vector3<f64>) -> UnitQuaternion<f64> {
    let angle2 = w.norm_squared();
    let angle = angle2.sqrt();
    let (real, factor) = if angle < SMALL_ANGLE {
        (1.0 - angle2 / 8.0, 0.5 - angle2 / 48.0)
    } else {
        let half = 0.5 * angle;
        (half.cos(), half.sin() / angle)
    };
    UnitQuaternion::new_normalize(Quaternion::from_parts(real, w * factor))
}

/// The axis-angle vector of `r`, of length at most π.
pub fn log(r: &UnitQuaternion<f64>) -> Vector3<f64> {
    // q and −q are one rotation; the one with w ≥ 0 has its angle in [0, π].
    let sign = if r.w < 0.0 { -1.0 } else { 1.0 };
    let (real, imag) = (sign * r.w, sign * r.imag());
    let sin_half = imag.norm();
    if sin_half < 0.5 * SMALL_ANGLE {
        // θ/sin(θ/2) = 2/w · (1 − tan²(θ/2)/3 + …)
        imag * (2.0 / real * (1.0 - (sin_half / real).powi(2) / 3.0))
    } else {
        imag * (2.0 * sin_half.atan2(real) / sin_half)
    }
}

/// J_l(w) with Exp(w + δ) ≈ Exp(J_l(w) δ) Exp(w).
pub fn left_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let angle2 = w.norm_squared();
    let angle = angle2.sqrt();
    let (a, b) = if angle < SMALL_ANGLE {
        (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
    } else {
        ((1.0 - angle.cos()) / angle2, (angle - angle.sin()) / (angle2 * angle))
    };
    let hat_w = hat(w);
    Matrix3::identity() + hat_w * a + hat_w * hat_w * b
}

/// J_l⁻¹(w) with Log(Exp(δ) Exp(w)) ≈ w + J_l⁻¹(w) δ.
pub fn left_jacobian_inverse(w: &Vector3<f64>) -> Matrix3<f64> {
    let angle2 = w.norm_squared();
    let angle = angle2.sqrt();
    let b = if angle < SMALL_ANGLE {
        1.0 / 12.0 + angle2 / 720.0
    } else {
        let half = 0.5 * angle;
        // 1/θ² − (1 + cos θ)/(2 θ sin θ), written with the half angle so that it stays finite at π.
        (1.0 - half * half.cos() / half.sin()) / angle2
    };
    let hat_w = hat(w);
    Matrix3::identity() - hat_w * 0.5 + hat_w * hat_w * b
}

/// The rotation that turns the mean up direction of cameras to `up`. A camera's own up direction is
/// −y. Without a mean, y is taken to point down, as in an image.
pub fn upright<'a>(
    cams_from_world: impl Iterator<Item = &'a UnitQuaternion<f64>>,
    up: &Vector3<f64>,
) -> UnitQuaternion<f64> {
    let mean: Vector3<f64> =
        cams_from_world.map(|rotation| rotation.inverse() * -Vector3::y()).sum();
    UnitQuaternion::rotation_between(&mean, up).unwrap_or_else(|| {
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
    })
}
