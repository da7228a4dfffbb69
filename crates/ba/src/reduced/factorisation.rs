//! What the reduced system asks of those that solve it.

use std::ops::Range;

use super::implicit::Eliminated;

/// The matrix could not be factorised: column `0` of the reduced system is not positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct NotPositive(pub(crate) usize);

/// Where the numbers of the lower triangle are.
pub(crate) trait Layout: Sync {
    /// First number of a block column, and of the one behind it.
    fn block_column(&self, a: usize) -> Range<usize>;
    /// Where, in its block column, the tile of rows `b` begins in the column number `column`
    /// (counted among the free ones). Of a block with itself, the rows from `column` on are stored
    /// there.
    fn tile_at(&self, a: usize, b: usize, column: usize) -> usize;
}

/// A way to solve the reduced system.
pub(crate) trait Factorisation: Layout + Send {
    /// Factorises the lower triangle in `numbers`.
    fn factorise(
        &mut self,
        numbers: &mut Vec<f64>,
        rest: Eliminated<'_>,
    ) -> Result<(), NotPositive>;
    /// Solves for several right-hand sides, one after the other in `x`; where that is done step by
    /// step, until the residual has shrunk to this part of them.
    fn solve(&mut self, numbers: &[f64], rest: Eliminated<'_>, x: &mut [f64], accuracy: f64);
}
