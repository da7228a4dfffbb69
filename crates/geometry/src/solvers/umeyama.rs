//! The similarity transform between two point sets (Umeyama 1991, "Least-squares estimation of
//! transformation parameters").

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::Sim3;

/// Singular values below this fraction of the largest count as zero.
const RANK_TOLERANCE: f64 = 1e-12;

/// The similarity transform that maps `from[i]` to `to[i]` with the smallest sum of squared errors,
/// with scale one unless `with_scale`. `None` for fewer than three points or collinear points.
pub fn umeyama(from: &[Vector3<f64>], to: &[Vector3<f64>], with_scale: bool) -> Option<Sim3> {
    let count = from.len().min(to.len());
    if count < 3 {
        return None;
    }
    let (from, to) = (&from[..count], &to[..count]);
    let mean = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / count as f64;
    let (mean_from, mean_to) = (mean(from), mean(to));
    let mut covariance = Matrix3::zeros();
    let mut variance = 0.0;
    for (from, to) in from.iter().zip(to) {
        covariance += (to - mean_to) * (from - mean_from).transpose();
        variance += (from - mean_from).norm_squared();
    }
    let svd = covariance.try_svd(true, true, f64::EPSILON, 0)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| svd.singular_values[j].total_cmp(&svd.singular_values[i]));
    let largest = svd.singular_values[order[0]];
    let has_rank_2 = svd.singular_values[order[1]] > RANK_TOLERANCE * largest && largest > 0.0;
    if !has_rank_2 {
        return None;
    }
    // If the solution is a reflection, flip the direction of the smallest singular value.
    let mut signs = Vector3::repeat(1.0);
    if u.determinant() * v_t.determinant() < 0.0 {
        signs[order[2]] = -1.0;
    }
    let matrix = u * Matrix3::from_diagonal(&signs) * v_t;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    let scale = if with_scale { svd.singular_values.dot(&signs) / variance } else { 1.0 };
    (scale.is_finite() && scale > 0.0).then(|| Sim3 {
        scale,
        rotation,
        translation: mean_to - rotation * mean_from * scale,
    })
}
