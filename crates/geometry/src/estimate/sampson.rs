//! The Sampson error of an epipolar constraint in pixels, for any camera model, and its derivative by the matrix.
//!
//! C = y₂ᵀ M y₁ over its gradient by the pixels: r = C / √(|J₂ᵀ M y₁|² + |J₁ᵀ Mᵀ y₂|²), where Jᵢ = d yᵢ / d pixelᵢ. For fundamental
//! matrices y = (x, y, 1) and J = (I, 0), which is the usual Sampson error; for essential matrices y is a unit ray.

use nalgebra::{Matrix3, Matrix3x2, Vector2, Vector3};

use crate::{CameraModel, Intrinsics};

/// A correspondence.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    pub(super) y1: Vector3<f64>,
    pub(super) y2: Vector3<f64>,
    d1: Matrix3x2<f64>,
    d2: Matrix3x2<f64>,
}

impl Pair {
    /// Points of the plane.
    pub(super) fn of_points(x1: &Vector2<f64>, x2: &Vector2<f64>) -> Self {
        let d = Matrix3x2::identity();
        Self { y1: x1.push(1.0), y2: x2.push(1.0), d1: d, d2: d }
    }

    /// The rays of two pixels; `None` where there is no ray.
    pub(super) fn of_pixels(
        pixel1: &Vector2<f64>,
        pixel2: &Vector2<f64>,
        intrinsics1: &Intrinsics,
        intrinsics2: &Intrinsics,
    ) -> Option<Self> {
        let (y1, d1) = ray_with_jacobian(pixel1, intrinsics1)?;
        let (y2, d2) = ray_with_jacobian(pixel2, intrinsics2)?;
        Some(Self { y1, y2, d1, d2 })
    }

    /// The squared error under the matrix `m`.
    #[inline]
    pub(super) fn squared_error(&self, m: &Matrix3<f64>) -> f64 {
        let (line2, line1) = (m * self.y1, m.tr_mul(&self.y2));
        let product = self.y2.dot(&line2);
        product * product / (self.d2.tr_mul(&line2).norm_squared() + self.d1.tr_mul(&line1).norm_squared())
    }

    /// The error, with sign, and its derivative by the entries of `m`.
    pub(super) fn error_with_derivative(&self, m: &Matrix3<f64>) -> Option<(f64, Matrix3<f64>)> {
        let (line2, line1) = (m * self.y1, m.tr_mul(&self.y2));
        let product = self.y2.dot(&line2);
        let (g2, g1) = (self.d2.tr_mul(&line2), self.d1.tr_mul(&line1));
        let norm2 = g2.norm_squared() + g1.norm_squared();
        let inverse = 1.0 / norm2.sqrt();
        if !inverse.is_finite() {
            return None;
        }
        let d_norm = self.d2 * g2 * self.y1.transpose() + self.y2 * (self.d1 * g1).transpose();
        let derivative = (self.y2 * self.y1.transpose() - d_norm * (product / norm2)) * inverse;
        Some((product * inverse, derivative))
    }
}

/// The unit ray of a pixel and its derivative by the pixel: the pseudo-inverse of the derivative of the projection, whose null
/// space is the ray itself.
fn ray_with_jacobian(
    pixel: &Vector2<f64>,
    intrinsics: &Intrinsics,
) -> Option<(Vector3<f64>, Matrix3x2<f64>)> {
    let ray = intrinsics.unproject(pixel)?;
    let d_point =
        with_camera_model!(intrinsics, M, params => M::project_with_jacobian(params, &ray)?.d_point);
    let d_ray = d_point.transpose() * (d_point * d_point.transpose()).try_inverse()?;
    Some((ray, d_ray))
}
