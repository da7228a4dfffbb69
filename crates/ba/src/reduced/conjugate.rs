//! Preconditioned conjugate gradients on the reduced system, for systems whose Cholesky factor
//! would not fit into memory. The matrix is sparse, or is never formed (see `implicit`). The
//! preconditioner is the Cholesky factorisation of the diagonal blocks: SCHUR_JACOBI in Ceres;
//! Agarwal, Snavely, Seitz, Szeliski 2010, "Bundle adjustment in the large", section 4.

use super::columns::Columns;
use super::factorisation::{Factorisation, Layout, NotPositive};
use super::implicit::EliminatedSystem;

/// After so many iterations the current iterate is the step. If it is a bad one, damping grows.
const MAX_ITERATIONS: usize = 500;

pub(crate) struct ConjugateGradients {
    columns: Columns,
    /// The columns are those of C, and the reduced system is never formed.
    implicit: bool,
    /// Cholesky factors of the diagonal blocks, each full and row by row.
    factors: Vec<f64>,
}

impl ConjugateGradients {
    pub(crate) fn new(columns: Columns, implicit: bool) -> Self {
        let len = columns.first_column.windows(2).map(|ends| (ends[1] - ends[0]).pow(2)).sum();
        Self { columns, implicit, factors: vec![0.0; len] }
    }

    /// Columns of each diagonal block, and the offset of its factor.
    fn blocks(&self) -> impl Iterator<Item = (std::ops::Range<usize>, usize)> {
        let mut at = 0;
        self.columns.first_column.windows(2).map(move |ends| {
            let start = at;
            at += (ends[1] - ends[0]).pow(2);
            (ends[0]..ends[1], start)
        })
    }

    /// y = S x, where `lower` is the lower triangle of S, or of C if `implicit`.
    fn multiply(&self, lower: &[f64], eliminated: EliminatedSystem<'_>, x: &[f64], y: &mut [f64]) {
        y.fill(0.0);
        if self.implicit {
            eliminated.subtract_product(x, y);
        }
        for (j, ends) in self.columns.column_at.windows(2).enumerate() {
            let range = ends[0] as usize..ends[1] as usize;
            let (lower, rows) = (&lower[range.clone()], &self.columns.row_of[range]);
            // The first element is on the diagonal.
            let (x_j, mut sum) = (x[j], lower[0] * x[j]);
            for (number, &row) in lower.iter().zip(rows).skip(1) {
                sum += number * x[row as usize];
                y[row as usize] += number * x_j;
            }
            y[j] += sum;
        }
    }

    /// z = M⁻¹ r.
    fn precondition(&self, r: &[f64], z: &mut [f64]) {
        z.copy_from_slice(r);
        for (columns, at) in self.blocks() {
            let (n, z) = (columns.len(), &mut z[columns]);
            let l = &self.factors[at..at + n * n];
            for i in 0..n {
                for j in 0..i {
                    z[i] -= l[i * n + j] * z[j];
                }
                z[i] /= l[i * n + i];
            }
            for i in (0..n).rev() {
                for j in i + 1..n {
                    z[i] -= l[j * n + i] * z[j];
                }
                z[i] /= l[i * n + i];
            }
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// y ← y + α x, as in BLAS.
fn axpy(y: &mut [f64], alpha: f64, x: &[f64]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += alpha * x);
}

impl Layout for ConjugateGradients {
    fn block_column(&self, a: usize) -> std::ops::Range<usize> {
        self.columns.block_column(a)
    }
    fn tile_at(&self, a: usize, b: usize, column: usize) -> usize {
        self.columns.tile_at(a, b, column)
    }
}

impl Factorisation for ConjugateGradients {
    fn factorise(
        &mut self,
        lower: &mut Vec<f64>,
        eliminated: EliminatedSystem<'_>,
    ) -> Result<(), NotPositive> {
        let blocks: Vec<_> = self.blocks().collect();
        for (a, (columns, at)) in blocks.iter().enumerate() {
            let (n, first) = (columns.len(), self.columns.block_column(a).start);
            for j in 0..n {
                let column = &lower[first + self.columns.tile_at(a, a, j)..][..n - j];
                (j..n).zip(column).for_each(|(i, number)| self.factors[at + i * n + j] = *number);
            }
        }
        if self.implicit {
            let first: Vec<usize> = blocks.iter().map(|block| block.1).collect();
            eliminated.subtract_diagonal(&first, &mut self.factors);
        }
        for (columns, at) in blocks {
            let n = columns.len();
            let l = &mut self.factors[at..at + n * n];
            for j in 0..n {
                for i in j..n {
                    let sum: f64 = (0..j).map(|k| l[i * n + k] * l[j * n + k]).sum();
                    l[i * n + j] -= sum;
                }
                let pivot = l[j * n + j];
                // NaN is not positive either.
                if pivot.is_nan() || pivot <= 0.0 {
                    return Err(NotPositive(columns.start + j));
                }
                let root = pivot.sqrt();
                (j..n).for_each(|i| l[i * n + j] /= root);
            }
        }
        Ok(())
    }

    fn solve(
        &mut self,
        lower: &[f64],
        eliminated: EliminatedSystem<'_>,
        x: &mut [f64],
        accuracy: f64,
    ) {
        let n = self.columns.len;
        let [mut r, mut z, mut p, mut s] = [(); 4].map(|()| vec![0.0; n]);
        for x in x.chunks_exact_mut(n.max(1)) {
            r.copy_from_slice(x);
            x.fill(0.0);
            self.precondition(&r, &mut z);
            p.copy_from_slice(&z);
            let mut rz = dot(&r, &z);
            let goal = rz * accuracy * accuracy;
            for _ in 0..MAX_ITERATIONS {
                self.multiply(lower, eliminated, &p, &mut s);
                let curvature = dot(&p, &s);
                // Converged, or the matrix is not positive definite to rounding. NaN ends the loop,
                // too.
                if !(rz > goal && curvature > 0.0) {
                    break;
                }
                let length = rz / curvature;
                axpy(x, length, &p);
                axpy(&mut r, -length, &s);
                self.precondition(&r, &mut z);
                let before = std::mem::replace(&mut rz, dot(&r, &z));
                for (p, z) in p.iter_mut().zip(&z) {
                    *p = z + rz / before * *p;
                }
            }
        }
    }
}
