//! Interface of the solvers of the reduced system.

use std::ops::Range;

use super::implicit::EliminatedSystem;

/// The matrix is not positive definite: column `0` of the reduced system has no positive pivot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct NotPositive(pub(crate) usize);

/// Memory layout of the lower triangle.
pub(crate) trait Layout: Sync {
    /// Range of the stored numbers of block column `a`.
    fn block_column(&self, a: usize) -> Range<usize>;
    /// Offset in block column `a` of the rows of block `b` in its free column number `column`. In a
    /// diagonal block, the rows from `column` on are stored there.
    fn tile_at(&self, a: usize, b: usize, column: usize) -> usize;
}

/// A solver of the reduced system.
pub(crate) trait Factorisation: Layout + Send {
    /// Factorises the lower triangle in `lower`.
    fn factorise(
        &mut self,
        lower: &mut Vec<f64>,
        eliminated: EliminatedSystem<'_>,
    ) -> Result<(), NotPositive>;
    /// Solves for several right-hand sides, one after the other in `x`. Iterative solvers stop when
    /// the preconditioned residual has fallen to `accuracy` times its initial norm.
    fn solve(
        &mut self,
        lower: &[f64],
        eliminated: EliminatedSystem<'_>,
        x: &mut [f64],
        accuracy: f64,
    );
}
