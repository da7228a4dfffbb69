//! The inverse of a distortion of the plane, by Newton's method that stays on the branch through
//! the centre.
//!
//! Polynomial distortions fold back: beyond some radius a growing angle gives a shrinking pixel
//! distance, and a pixel has further, meaningless pre-images. All distortions here have a
//! derivative that is symmetric (but for a thin prism, a little) and positive definite from the
//! centre up to the fold, where it loses that, so steps are shortened until they stay where it
//! holds.

use nalgebra::{Matrix2, Vector2};

/// Newton steps; quadratic convergence needs fewer than 10 except within about 1e-6 of the fold.
const MAX_STEPS: usize = 50;

/// Halvings of one step before giving up.
const MAX_HALVINGS: usize = 40;

/// Accepted error, relative to the size of the numbers: a few rounding errors of the polynomial.
const TOLERANCE: f64 = 1e-14;

/// The point that `distort` (value and derivative) takes to `target`; `None` beyond the fold.
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

/// Of a matrix that is nearly symmetric.
fn is_positive_definite(m: &Matrix2<f64>) -> bool {
    m.trace() > 0.0 && m.determinant() > 0.0
}
