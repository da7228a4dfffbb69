//! Fundamental matrices from seven correspondences, and from eight or more.
//!
//! Seven: Hartley and Zisserman 2004, section 11.1.2: F = λ F₁ + (1 − λ) F₂ of the null space, with
//! det F = 0 a cubic in λ. Eight or more: the normalised 8-point algorithm (Hartley 1997, "In
//! defense of the eight-point algorithm").

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, SMatrix, Vector2, Vector3};

use super::null_space::{as_matrix, epipolar_row, least_squares_null_vector, null_space};
use super::polynomial::cubic_roots;

/// The fundamental matrices, of Frobenius norm 1, with `points2[i]ᵀ F points1[i] = 0`. The points
/// should be normalised to coordinates of size 1.
pub fn fundamental_7pt(
    points1: &[Vector2<f64>; 7],
    points2: &[Vector2<f64>; 7],
) -> ArrayVec<Matrix3<f64>, 3> {
    let mut rows = SMatrix::<f64, 9, 7>::zeros();
    for i in 0..7 {
        rows.set_column(i, &epipolar_row(&points1[i].push(1.0), &points2[i].push(1.0)));
    }
    let basis = null_space::<7, 2>(rows);
    let a = as_matrix(&basis.column(0).into_owned());
    let b = as_matrix(&basis.column(1).into_owned());
    // The cubic det(a + λ b). a and b are interchangeable: the larger of det a and det b becomes
    // the leading coefficient.
    let (a, b) = if a.determinant().abs() > b.determinant().abs() { (b, a) } else { (a, b) };
    let mixed = |p: &Matrix3<f64>, q: &Matrix3<f64>| {
        p.column(0).cross(&p.column(1)).dot(&q.column(2))
            + p.column(1).cross(&p.column(2)).dot(&q.column(0))
            + p.column(2).cross(&p.column(0)).dot(&q.column(1))
    };
    let roots = cubic_roots([a.determinant(), mixed(&a, &b), mixed(&b, &a), b.determinant()]);
    roots
        .into_iter()
        .map(|lambda| (a + b * lambda).normalize())
        .filter(|f| f.iter().all(|v| v.is_finite()))
        .collect()
}

/// The fundamental matrix, of Frobenius norm 1, that minimises the algebraic error over eight or
/// more correspondences. `None` for fewer, or if the points of an image coincide.
pub fn fundamental_8pt(points1: &[Vector2<f64>], points2: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    let count = points1.len().min(points2.len());
    if count < 8 {
        return None;
    }
    let (to_unit1, to_unit2) =
        (normalisation(&points1[..count])?, normalisation(&points2[..count])?);
    let rows = points1[..count]
        .iter()
        .zip(&points2[..count])
        .map(|(x1, x2)| epipolar_row(&(to_unit1 * x1.push(1.0)), &(to_unit2 * x2.push(1.0))));
    let null_vector = least_squares_null_vector(rows)?;
    let svd = as_matrix(&null_vector).try_svd(true, true, f64::EPSILON, 0)?;
    let weakest = svd.singular_values.imin();
    let mut singular = svd.singular_values;
    singular[weakest] = 0.0;
    let rank2: Matrix3<f64> = svd.u? * Matrix3::from_diagonal(&singular) * svd.v_t?;
    let f = (to_unit2.transpose() * rank2 * to_unit1).normalize();
    f.iter().all(|v| v.is_finite()).then_some(f)
}

/// The normalising similarity of Hartley 1997: it maps the centroid of the points to the origin and
/// their mean distance from it to √2. `None` if the points coincide.
pub(crate) fn normalisation(points: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    let count = points.len() as f64;
    let centre = points.iter().sum::<Vector2<f64>>() / count;
    let distance = points.iter().map(|p| (p - centre).norm()).sum::<f64>() / count;
    let scale = std::f64::consts::SQRT_2 / distance;
    (scale.is_finite() && scale > 0.0).then(|| {
        Matrix3::from_columns(&[
            Vector3::x() * scale,
            Vector3::y() * scale,
            Vector3::new(-centre.x * scale, -centre.y * scale, 1.0),
        ])
    })
}
