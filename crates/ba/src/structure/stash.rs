//! What is kept of a cell until its variable's step is known, and how long it is.

use super::elimination::Elimination;

/// Numbers kept of a cell: L row by row, with the inverses of its diagonal in place of that, y, and
/// Y: block by block, of each block a row for each direction, without padding. The rest follows:
/// g_p = Ly, and the diagonal of V is that of LLᵀ.
///
/// Y is in single precision, two in place of one, for it is most of the memory, and of what is read
/// and written: a step of eliminated variables that is wrong in the eighth digit is as good. Not
/// where the reduced system is made of Y, for what is left of C − YᵀY when λ is small may be less
/// than that.
pub(crate) fn stash_len(dof: usize, dense: usize, elimination: Elimination) -> usize {
    let numbers = dof * dense + STASH_SLACK;
    stash_head(dof)
        + if elimination == Elimination::Implicit { numbers } else { numbers.div_ceil(2) }
}

/// The last vector of the last row may reach so far beyond it.
const STASH_SLACK: usize = 3;

/// Those before Y.
pub(crate) fn stash_head(dof: usize) -> usize {
    row(dof) + dof
}

/// Where a row of L begins.
#[inline(always)]
pub(crate) fn row(i: usize) -> usize {
    i * (i + 1) / 2
}
