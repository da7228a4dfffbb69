//! Rotations from the numbers in files.

use tiepoint_geometry::nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion};

/// A quaternion whose squared norm differs from 1 by less is taken as it is, so that what we wrote
/// is read bit by bit.
const UNIT_TOLERANCE: f64 = 1e-12;
/// A quaternion shorter than this is no rotation.
const MIN_QUATERNION_NORM: f64 = 1e-6;
/// How far a matrix of a file may be from the nearest rotation (Frobenius norm): enough for three
/// digits.
const MAX_MATRIX_DEVIATION: f64 = 1e-2;

/// A rotation from a Hamilton quaternion, normalised.
pub(crate) fn from_wxyz([w, x, y, z]: [f64; 4]) -> Result<UnitQuaternion<f64>, String> {
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    if !norm.is_finite() || norm < MIN_QUATERNION_NORM {
        return Err(format!("a quaternion of norm {norm} is no rotation"));
    }
    if (norm * norm - 1.0).abs() < UNIT_TOLERANCE {
        return Ok(UnitQuaternion::new_unchecked(quaternion));
    }
    Ok(UnitQuaternion::new_normalize(quaternion))
}

/// The rotation nearest to a matrix that is one but for rounding.
pub(crate) fn from_matrix(matrix: &Matrix3<f64>) -> Result<UnitQuaternion<f64>, String> {
    // The decomposition goes round for ever where squares overflow; no entry of a rotation is above
    // 1. What is no number is nowhere near one.
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
