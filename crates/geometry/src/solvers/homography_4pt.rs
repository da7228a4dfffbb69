//! Homographies: of four correspondences, as the composition of two projective frames (Heckbert
//! 1989; Hartley and Zisserman 2004, section 2.3), and of four or more by the normalised direct
//! linear transformation (Hartley and Zisserman 2004, algorithm 4.2).

use nalgebra::{Matrix3, Vector2, Vector3};

use super::fundamental_7pt::normalisation;
use super::null_space::{Vector9, as_matrix, least_squares_null_vector};

/// The homography, of Frobenius norm 1, that maps `points1[i]` to `points2[i]`. `None` if three
/// points of an image are collinear, or if the depths of the four points differ in sign.
pub fn homography_4pt(
    points1: &[Vector2<f64>; 4],
    points2: &[Vector2<f64>; 4],
) -> Option<Matrix3<f64>> {
    let (frame1, weights1) = projective_frame(points1)?;
    let (frame2, weights2) = projective_frame(points2)?;
    // frame · diag(weights) maps the unit vectors and their sum to the four points. The depths of
    // the four points have one sign if the ratios of the weights have one sign.
    let ratios = weights2.component_div(&weights1);
    if !(ratios.min() > 0.0 || ratios.max() < 0.0) {
        return None;
    }
    let h = (frame2 * Matrix3::from_diagonal(&ratios) * frame1.try_inverse()?).normalize();
    // The depths have the sign of the ratios: make them positive.
    let h = if ratios.x < 0.0 { -h } else { h };
    h.iter().all(|v| v.is_finite()).then_some(h)
}

/// The first three points as columns, and the weights with which they sum to the fourth.
fn projective_frame(points: &[Vector2<f64>; 4]) -> Option<(Matrix3<f64>, Vector3<f64>)> {
    let frame =
        Matrix3::from_columns(&[points[0].push(1.0), points[1].push(1.0), points[2].push(1.0)]);
    let weights = frame.try_inverse()? * points[3].push(1.0);
    Some((frame, weights)).filter(|_| weights.iter().all(|w| *w != 0.0 && w.is_finite()))
}

/// The homography, of Frobenius norm 1, that minimises the algebraic error over four or more
/// correspondences. `None` for fewer, or if the points of an image coincide.
pub fn homography_dlt(points1: &[Vector2<f64>], points2: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    let count = points1.len().min(points2.len());
    if count < 4 {
        return None;
    }
    let (to_unit1, to_unit2) =
        (normalisation(&points1[..count])?, normalisation(&points2[..count])?);
    let rows = points1[..count].iter().zip(&points2[..count]).flat_map(|(x1, x2)| {
        let (x, y) = (to_unit1 * x1.push(1.0), to_unit2 * x2.push(1.0));
        // Two rows of y × Hx = 0.
        [
            Vector9::from_column_slice(&[0., 0., 0., -x.x, -x.y, -1., y.y * x.x, y.y * x.y, y.y]),
            Vector9::from_column_slice(&[x.x, x.y, 1., 0., 0., 0., -y.x * x.x, -y.x * x.y, -y.x]),
        ]
    });
    let null_vector = least_squares_null_vector(rows)?;
    let h = (to_unit2.try_inverse()? * as_matrix(&null_vector) * to_unit1).normalize();
    h.iter().all(|v| v.is_finite()).then_some(h)
}
