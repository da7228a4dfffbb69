//! Rotations and poses from numbers of files.

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

/// Largest accepted deviation of a quaternion's norm, and of the entries of RᵀR, from their values
/// for a rotation: three digits are precise to less.
const ROTATION_TOLERANCE: f64 = 1e-2;

/// A rotation from a Hamilton quaternion, w first.
pub(super) fn rotation_of_quaternion(
    wxyz: [f64; 4],
) -> std::result::Result<UnitQuaternion<f64>, String> {
    let [w, x, y, z] = wxyz;
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    if (norm - 1.0).abs() < ROTATION_TOLERANCE {
        Ok(UnitQuaternion::from_quaternion(quaternion))
    } else {
        Err(format!("is no rotation: the quaternion has the norm {norm} and not 1"))
    }
}

/// A pose from the first three rows of a 4 × 4 matrix.
pub(super) fn pose_of_matrix(numbers: &[f64; 16]) -> std::result::Result<Rigid3, String> {
    let matrix = Matrix3::from_fn(|row, column| numbers[4 * row + column]);
    let deviation = (matrix.transpose() * matrix - Matrix3::identity()).abs().max();
    if deviation >= ROTATION_TOLERANCE || matrix.determinant() <= 0.0 {
        return Err("is no pose: its left three columns are no rotation".to_owned());
    }
    if numbers[12..] != [0.0, 0.0, 0.0, 1.0] {
        return Err("is no pose: its last row is not 0 0 0 1".to_owned());
    }
    // The nearest rotation.
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&matrix));
    Ok(Rigid3 { rotation, translation: Vector3::from_fn(|row, _| numbers[4 * row + 3]) })
}
