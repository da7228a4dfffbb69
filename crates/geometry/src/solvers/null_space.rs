//! Null spaces of matrices with nine columns, exact and in the least-squares sense.

use nalgebra::{SMatrix, SVector};

/// The entries of a 3×3 matrix, row by row.
pub(crate) type Vector9 = SVector<f64, 9>;

/// An orthonormal basis, one vector per column, of `K = 9 − N` vectors orthogonal to the `N`
/// columns of `rows`, by Householder QR. If the columns are dependent, the basis is not unique.
pub(crate) fn null_space<const N: usize, const K: usize>(
    mut rows: SMatrix<f64, 9, N>,
) -> SMatrix<f64, 9, K> {
    const { assert!(N + K == 9) };
    let mut reflectors = [[0.0; 9]; N];
    for (k, reflector) in reflectors.iter_mut().enumerate() {
        // The reflection I − v vᵀ with |v|² = 2 that takes column k to a multiple of e_k.
        let mut norm2 = 0.0;
        for i in k..9 {
            reflector[i] = rows[(i, k)];
            norm2 += reflector[i] * reflector[i];
        }
        let norm = norm2.sqrt();
        let length2 = 2.0 * norm * (norm + reflector[k].abs());
        if length2 <= f64::MIN_POSITIVE {
            reflector.fill(0.0);
            continue;
        }
        reflector[k] += norm.copysign(reflector[k]);
        let scale = (2.0 / length2).sqrt();
        for v in &mut reflector[k..] {
            *v *= scale;
        }
        for column in k + 1..N {
            let dot: f64 = (k..9).map(|i| reflector[i] * rows[(i, column)]).sum();
            for i in k..9 {
                rows[(i, column)] -= reflector[i] * dot;
            }
        }
    }
    // The last columns of Q.
    let mut basis = SMatrix::<f64, 9, K>::zeros();
    for column in 0..K {
        basis[(N + column, column)] = 1.0;
        for (k, reflector) in reflectors.iter().enumerate().rev() {
            let dot: f64 = (k..9).map(|i| reflector[i] * basis[(i, column)]).sum();
            for i in k..9 {
                basis[(i, column)] -= reflector[i] * dot;
            }
        }
    }
    basis
}

/// The coefficients of the entries of M, row by row, in x₂ᵀ M x₁.
pub(crate) fn epipolar_row(x1: &nalgebra::Vector3<f64>, x2: &nalgebra::Vector3<f64>) -> Vector9 {
    Vector9::from_fn(|i, _| x2[i / 3] * x1[i % 3])
}

/// The 3×3 matrix of nine entries, row by row.
pub(crate) fn as_matrix(v: &Vector9) -> nalgebra::Matrix3<f64> {
    nalgebra::Matrix3::from_row_slice(v.as_slice())
}

/// The unit vector v that minimises Σ (row·v)². Givens rotations reduce the rows, one by one, to a
/// triangular matrix with the same right singular vectors. Normal equations would square the
/// condition number.
pub(crate) fn least_squares_null_vector(
    rows: impl IntoIterator<Item = Vector9>,
) -> Option<Vector9> {
    let mut triangle = SMatrix::<f64, 9, 9>::zeros();
    for mut row in rows {
        for k in 0..9 {
            let length = triangle[(k, k)].hypot(row[k]);
            if length == 0.0 {
                continue;
            }
            let (c, s) = (triangle[(k, k)] / length, row[k] / length);
            for i in k..9 {
                let (a, b) = (triangle[(k, i)], row[i]);
                triangle[(k, i)] = c * a + s * b;
                row[i] = c * b - s * a;
            }
        }
    }
    let svd = triangle.try_svd(false, true, f64::EPSILON, 0)?;
    Some(svd.v_t?.row(svd.singular_values.imin()).transpose())
}
