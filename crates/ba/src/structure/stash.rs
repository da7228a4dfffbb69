//! Length of the results of elimination that back-substitution needs.

use super::elimination::Elimination;

/// Stash of a landmark: its numbers that are kept until its step is computed. These are L, row by
/// row with the inverse diagonal; y; and Y, block by block, with one row for each direction of the
/// landmark, without padding. g_p = Ly and the diagonal of V = LLᵀ follow from them.
///
/// Y is most of the memory and of the memory traffic, so it is in single precision, two numbers in
/// one. Steps of landmarks then are wrong in the eighth digit. The implicit solver needs Y in
/// double precision, because it forms C − YᵀY from Y, and for small λ that difference may be below
/// single precision.
pub(crate) fn stash_len(dof: usize, packed_width: usize, elimination: Elimination) -> usize {
    let numbers = dof * packed_width + STASH_SLACK;
    stash_head(dof)
        + if elimination == Elimination::Implicit { numbers } else { numbers.div_ceil(2) }
}

/// The last vector of the last row may reach beyond it by this many elements.
const STASH_SLACK: usize = 3;

/// Offset of Y in a stash.
pub(crate) fn stash_head(dof: usize) -> usize {
    triangle_row(dof) + dof
}

/// Offset of row i in a lower triangle that is stored row by row, as L is.
#[inline(always)]
pub(crate) fn triangle_row(i: usize) -> usize {
    i * (i + 1) / 2
}
