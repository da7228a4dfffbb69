//! Rotations from quaternions and matrices in files.

use tiepoint_geometry::nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion};

/// A quaternion with a squared norm this close to 1 is not normalised, so that written quaternions
/// keep all bits.
const UNIT_TOLERANCE: f64 = 1e-12;
/// Norms of quaternions of three digits. Others are of columns in another order, as those of a
/// translation.
const QUATERNION_NORMS: std::ops::RangeInclusive<f64> = 0.99..=1.01;
/// Largest Frobenius distance of a matrix to the nearest rotation: enough for matrices of three
/// digits.
const MAX_MATRIX_DEVIATION: f64 = 1e-2;

/// The rotation of a Hamilton quaternion, which is normalised.
pub(crate) fn from_wxyz([w, x, y, z]: [f64; 4]) -> Result<UnitQuaternion<f64>, String> {
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    if !QUATERNION_NORMS.contains(&norm) {
        return Err(format!("a quaternion of norm {norm} is no rotation"));
    }
    if (norm * norm - 1.0).abs() < UNIT_TOLERANCE {
        return Ok(UnitQuaternion::new_unchecked(quaternion));
    }
    Ok(UnitQuaternion::new_normalize(quaternion))
}

/// The rotation nearest to a matrix (Frobenius norm); an error if the matrix is not a rotation up
/// to rounding.
pub(crate) fn from_matrix(matrix: &Matrix3<f64>) -> Result<UnitQuaternion<f64>, String> {
    // The SVD does not terminate if squares overflow. Entries of a rotation are at most 1, so NaN
    // and larger entries are rejected first.
    if matrix.amax().is_nan() || matrix.amax() > 1.0 + MAX_MATRIX_DEVIATION {
        return Err("the matrix is no rotation".to_owned());
    }
    let svd = matrix.svd(true, true);
    let nearest =
        svd.u.zip(svd.v_t).map(|(u, v_t)| u * v_t).filter(|nearest| nearest.determinant() > 0.0);
    match nearest {
        Some(nearest) if (nearest - matrix).norm() < MAX_MATRIX_DEVIATION => {
            Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(nearest)))
        }
        _ => Err("the matrix is no rotation".to_owned()),
    }
}
