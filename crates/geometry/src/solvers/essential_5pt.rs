//! Essential matrices from five correspondences (Nistér 2004, "An efficient solution to the
//! five-point relative pose problem").
//!
//! The five epipolar constraints give E = xX + yY + zZ + W with a basis X, Y, Z, W of their null
//! space. The cubic constraints det E = 0 and 2EEᵀE − tr(EEᵀ)E = 0 are ten polynomials in the
//! twenty monomials of x, y and z up to degree three. Elimination of the first ten monomials, and
//! differences of suitable rows (Nistér's ⟨k⟩, ⟨l⟩, ⟨m⟩), leave a 3×3 matrix B(z) with B(z) (x, y,
//! 1)ᵀ = 0. Its determinant is of degree ten in z, and its roots are the solutions.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::null_space::{as_matrix, epipolar_row, null_space};
use super::sturm::real_roots;

/// A linear form in (x, y, z, 1).
type Linear = [f64; 4];
/// A quadratic form: x², xy, xz, x, y², yz, y, z², z, 1.
type Quadratic = [f64; 10];
/// A cubic form, in [`eliminate`]'s order of monomials.
type Cubic = [f64; 20];

/// The essential matrices, of Frobenius norm √2, with `rays2[i]ᵀ E rays1[i] = 0`. `rays1[i]` and
/// `rays2[i]` are corresponding unit rays in cameras 1 and 2.
pub fn essential_5pt(
    rays1: &[Vector3<f64>; 5],
    rays2: &[Vector3<f64>; 5],
) -> ArrayVec<Matrix3<f64>, 10> {
    let mut rows = SMatrix::<f64, 9, 5>::zeros();
    for i in 0..5 {
        rows.set_column(i, &epipolar_row(&rays1[i], &rays2[i]));
    }
    let basis = null_space::<5, 4>(rows);
    let Some(reduced) = eliminate(constraints(&basis)) else { return ArrayVec::new() };

    // Rows: ⟨k⟩ = ⟨x²z⟩ − z⟨x²⟩, ⟨l⟩ = ⟨y²z⟩ − z⟨y²⟩, ⟨m⟩ = ⟨xyz⟩ − z⟨xy⟩; columns: coefficients of
    // x, y and 1 as polynomials in z.
    let b: [([f64; 4], [f64; 4], [f64; 5]); 3] = [0, 2, 4].map(|row| {
        let (e, f) = (&reduced[row], &reduced[row + 1]);
        (
            [e[2], e[1] - f[2], e[0] - f[1], -f[0]],
            [e[5], e[4] - f[5], e[3] - f[4], -f[3]],
            [e[9], e[8] - f[9], e[7] - f[8], e[6] - f[7], -f[6]],
        )
    });
    let mut determinant = [0.0; 11];
    for (i, j, k) in [(0, 1, 2), (1, 2, 0), (2, 0, 1)] {
        // (b_i0 b_j1 − b_j0 b_i1) b_k2
        let mut minor = [0.0; 7];
        for p in 0..4 {
            for q in 0..4 {
                minor[p + q] += b[i].0[p] * b[j].1[q] - b[j].0[p] * b[i].1[q];
            }
        }
        for p in 0..7 {
            for q in 0..5 {
                determinant[p + q] += minor[p] * b[k].2[q];
            }
        }
    }

    let mut essentials = ArrayVec::new();
    for z in real_roots(&determinant) {
        let row = |i: usize| {
            let at = |c: &[f64]| c.iter().rev().fold(0.0, |sum, c| sum * z + c);
            Vector3::new(at(&b[i].0), at(&b[i].1), at(&b[i].2))
        };
        let rows = [row(0), row(1), row(2)];
        // (x, y, 1) is orthogonal to all three rows: the cross product of two of them, the pair
        // with the largest third component.
        let solution =
            [(0, 1), (1, 2), (2, 0)].map(|(i, j)| rows[i].cross(&rows[j])).into_iter().fold(
                Vector3::zeros(),
                |best: Vector3<f64>, v| if v.z.abs() > best.z.abs() { v } else { best },
            );
        let coefficients =
            SVector::<f64, 4>::new(solution.x / solution.z, solution.y / solution.z, z, 1.0);
        essentials.extend(refine(&basis, coefficients));
    }
    essentials
}

/// Maximum number of Gauss-Newton steps on the cubic constraints, which reduce the rounding error
/// of the elimination and of the root.
const MAX_REFINEMENT_STEPS: usize = 4;

/// Rounding error of the cubic constraints, for E of norm √2.
const EXACT: f64 = 1e-14;

/// Refines the essential matrix that is the combination of the basis with these coefficients, by
/// Gauss-Newton on the cubic constraints. The result has norm √2.
fn refine(basis: &SMatrix<f64, 9, 4>, coefficients: SVector<f64, 4>) -> Option<Matrix3<f64>> {
    let coefficients = coefficients.normalize();
    // The scale is fixed by the largest coefficient; the other three are free.
    let fixed = coefficients.iamax();
    let moving = [(fixed + 1) % 4, (fixed + 2) % 4, (fixed + 3) % 4];
    let directions = moving.map(|i| as_matrix(&basis.column(i).into_owned()));
    let mut e = as_matrix(&(basis * coefficients)) * std::f64::consts::SQRT_2;
    for _ in 0..MAX_REFINEMENT_STEPS {
        let (square, trace) = (e * e.transpose(), e.norm_squared());
        let residual = square * e * 2.0 - e * trace;
        if residual.norm() < EXACT {
            break;
        }
        // Derivatives of 2EEᵀE − tr(EEᵀ)E. If it is zero, det E is zero too.
        let e_t_e = e.tr_mul(&e);
        let derivatives = directions.map(|d| {
            (d * e_t_e + e * d.tr_mul(&e) + square * d) * 2.0 - e * (2.0 * e.dot(&d)) - d * trace
        });
        let hessian = Matrix3::from_fn(|i, j| derivatives[i].dot(&derivatives[j]));
        let gradient = Vector3::from_fn(|i, _| derivatives[i].dot(&residual));
        let Some(step) = hessian.try_inverse().map(|inverse| inverse * gradient) else { break };
        e -= directions[0] * step.x + directions[1] * step.y + directions[2] * step.z;
        e *= std::f64::consts::SQRT_2 / e.norm();
    }
    e.iter().all(|v| v.is_finite()).then_some(e)
}

/// Index in a [`Quadratic`] of the product of two variables (x, y, z, 1).
const QUADRATIC: [[usize; 4]; 4] = [[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]];

/// Index in a [`Cubic`] of the product of a quadratic monomial and a variable. Its order is x³, y³,
/// x²y, xy², x²z, x², y²z, y², xyz, xy, then xz², xz, x, yz², yz, y, z³, z², z, 1.
const CUBIC: [[usize; 4]; 10] = [
    [0, 2, 4, 5],
    [2, 3, 8, 9],
    [4, 8, 10, 11],
    [5, 9, 11, 12],
    [3, 1, 6, 7],
    [8, 6, 13, 14],
    [9, 7, 14, 15],
    [10, 13, 16, 17],
    [11, 14, 17, 18],
    [12, 15, 18, 19],
];

/// Adds `sign` times the product of two linear forms.
fn multiply(a: &Linear, b: &Linear, sum: &mut Quadratic, sign: f64) {
    for i in 0..4 {
        for j in 0..4 {
            sum[QUADRATIC[i][j]] += sign * a[i] * b[j];
        }
    }
}

/// Adds the product of a quadratic and a linear form.
fn multiply_add(a: &Quadratic, b: &Linear, sum: &mut Cubic) {
    for i in 0..10 {
        for j in 0..4 {
            sum[CUBIC[i][j]] += a[i] * b[j];
        }
    }
}

/// The ten cubic constraints: det E = 0 and the entries of (EEᵀ − tr(EEᵀ)/2 I) E = 0.
#[allow(clippy::needless_range_loop)] // Indices as in the formulas.
fn constraints(basis: &SMatrix<f64, 9, 4>) -> [Cubic; 10] {
    let e: [[Linear; 3]; 3] = std::array::from_fn(|i| {
        std::array::from_fn(|j| std::array::from_fn(|k| basis[(3 * i + j, k)]))
    });
    let mut cubics = [[0.0; 20]; 10];

    for j in 0..3 {
        let (p, q) = ((j + 1) % 3, (j + 2) % 3);
        let mut minor = [0.0; 10];
        multiply(&e[1][p], &e[2][q], &mut minor, 1.0);
        multiply(&e[1][q], &e[2][p], &mut minor, -1.0);
        multiply_add(&minor, &e[0][j], &mut cubics[0]);
    }

    // L = EEᵀ − tr(EEᵀ)/2 I, and L E = 0.
    let mut l = [[[0.0; 10]; 3]; 3];
    for i in 0..3 {
        for j in i..3 {
            for k in 0..3 {
                multiply(&e[i][k], &e[j][k], &mut l[i][j], 1.0);
            }
            l[j][i] = l[i][j];
        }
    }
    for t in 0..10 {
        let half_trace = 0.5 * (l[0][0][t] + l[1][1][t] + l[2][2][t]);
        for i in 0..3 {
            l[i][i][t] -= half_trace;
        }
    }
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                multiply_add(&l[i][k], &e[k][j], &mut cubics[1 + 3 * i + j]);
            }
        }
    }
    cubics
}

/// Gauss-Jordan elimination of the first ten monomials, with row pivoting. Returns the coefficients
/// of the last ten monomials in the rows of x²z, x², y²z, y², xyz and xy.
fn eliminate(mut rows: [Cubic; 10]) -> Option<[[f64; 10]; 6]> {
    for column in 0..10 {
        let pivot = (column..10).fold(column, |best, row| {
            if rows[row][column].abs() > rows[best][column].abs() { row } else { best }
        });
        rows.swap(column, pivot);
        let inverse = 1.0 / rows[column][column];
        if !inverse.is_finite() {
            return None;
        }
        for value in &mut rows[column][column..] {
            *value *= inverse;
        }
        let pivot_row = rows[column];
        // Above the pivot, only the returned rows are eliminated.
        for row in (4.min(column)..10).filter(|&row| row != column) {
            let factor = rows[row][column];
            for i in column..20 {
                rows[row][i] -= factor * pivot_row[i];
            }
        }
    }
    Some(std::array::from_fn(|row| std::array::from_fn(|i| rows[4 + row][10 + i])))
}
