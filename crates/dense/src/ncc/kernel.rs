//! What a kernel is, on any instruction set.

use super::constants::MIN_VARIANCE;
use super::patch::Patch;
use super::source::Source;

/// Image of a patch through a plane: the homogeneous position of its centre, and the derivatives
/// by the offset in x and y, in pixel indices.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Warp {
    pub(crate) centre: [f32; 3],
    pub(crate) dx: [f32; 3],
    pub(crate) dy: [f32; 3],
}

/// The kernel on one instruction set.
pub(crate) trait Ncc: Copy {
    /// 1 − correlation, from 0 to 2; [`OUTSIDE`](super::OUTSIDE) if a sample is outside of the
    /// source.
    fn cost(source: &Source, warp: &Warp, patch: &Patch) -> f32;
}

/// Work that runs compiled for an instruction set.
pub(crate) trait Task {
    type Output;
    fn run<N: Ncc>(self) -> Self::Output;
}

/// The cost from the sums of w·s, w·s² and w·(r − mean)·s.
#[inline(always)]
pub(super) fn cost_of(sum: f32, squares: f32, products: f32, patch: &Patch) -> f32 {
    let variance = squares - sum * sum;
    if variance < MIN_VARIANCE {
        return 1.0;
    }
    1.0 - products * patch.inverse_deviation / variance.sqrt()
}
