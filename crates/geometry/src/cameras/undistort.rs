//! The inverse of a lens distortion, by Newton's method restricted to the branch through the
//! centre.
//!
//! Polynomial distortions fold back: beyond some radius, the distorted radius decreases with the
//! undistorted radius, and a pixel has further pre-images that are not physical. The Jacobian of
//! every distortion here is symmetric, or nearly symmetric for a thin prism. It is positive
//! definite from the centre up to the fold. Newton steps are shortened until they stay in this
//! region.

use nalgebra::{Matrix2, Vector2};

/// Maximum number of Newton steps; quadratic convergence needs fewer than 10 except within about
/// 1e-6 of the fold.
const MAX_STEPS: usize = 50;

/// Maximum number of halvings of one step.
const MAX_HALVINGS: usize = 40;

/// Tolerance of the error, relative to 1 + |target|: a few rounding errors of the polynomial.
const TOLERANCE: f64 = 1e-14;

/// The point that `distort`, which returns value and Jacobian, maps to `target`; `None` beyond the
/// fold.
pub(super) fn undistort(
    target: Vector2<f64>,
    distort: impl Fn(&Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>),
) -> Option<Vector2<f64>> {
    let tolerance = TOLERANCE * (1.0 + target.norm());
    let mut point = target;
    let (mut value, mut derivative) = distort(&point);
    for _ in 0..MAX_HALVINGS {
        if is_positive_definite(&derivative) {
            break;
        }
        point *= 0.5;
        (value, derivative) = distort(&point);
    }
    let mut error = value - target;
    for _ in 0..MAX_STEPS {
        if !is_positive_definite(&derivative) {
            return None;
        }
        if error.norm() <= tolerance {
            return Some(point);
        }
        let step = derivative.try_inverse()? * error;
        let mut scale = 1.0;
        (point, error, derivative) = (0..MAX_HALVINGS).find_map(|_| {
            let candidate = point - step * scale;
            let (value, derivative) = distort(&candidate);
            let candidate_error = value - target;
            scale *= 0.5;
            let better = candidate_error.norm() < error.norm() && is_positive_definite(&derivative);
            better.then_some((candidate, candidate_error, derivative))
        })?;
    }
    None
}

/// Whether a nearly symmetric matrix is positive definite.
fn is_positive_definite(m: &Matrix2<f64>) -> bool {
    m.trace() > 0.0 && m.determinant() > 0.0
}
