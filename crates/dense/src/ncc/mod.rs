//! Bilaterally weighted normalised cross-correlation (Schönberger 2016, Eq. 3) between a patch of
//! the reference image and its image through a plane, in 32 samples.
//!
//! A source image is stored as one word a pixel that holds the four pixels of its bilinear
//! interpolation, so that a sample is one load. Positions are rounded down to 1/64 pixel, which
//! makes the interpolation exact in integers. Sums run over 16 lanes in a fixed order, without
//! fused multiply-add, so that the costs have the same bits on every instruction set.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod isa;
mod patch;
mod portable;
mod source;
#[cfg(test)]
mod tests;

pub(crate) use isa::{Isa, dispatch};
pub(crate) use patch::{Patch, PatchTable};
pub(crate) use source::Source;

/// Cost of a patch with a sample outside of the source image: that of a correlation of −1.
pub(crate) const OUTSIDE: f32 = 2.0;
/// Number of samples of a patch.
const SAMPLES: usize = 32;
/// Number of lanes of a sum.
const LANES: usize = 16;
/// Steps of a position in a pixel.
const STEPS: i32 = 64;
/// Units of an interpolated grey level.
const UNITS: f32 = 16.0;
/// Subtracted from grey levels, so that sums of squares lose few bits.
const MIDDLE: f32 = 2040.0;
/// Smallest variance of a patch: a standard deviation of one grey level, three times that of
/// rounding to a byte and its interpolation. The correlation of a flatter patch is noise.
const MIN_VARIANCE: f32 = UNITS * UNITS;

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
    /// 1 − correlation, from 0 to 2; [`OUTSIDE`] if a sample is outside of the source.
    fn cost(source: &Source, warp: &Warp, patch: &Patch) -> f32;
}

/// Work that runs compiled for an instruction set.
pub(crate) trait Task {
    type Output;
    fn run<N: Ncc>(self) -> Self::Output;
}

/// The cost from the sums of w·s, w·s² and w·(r − mean)·s.
#[inline(always)]
fn cost_of(sum: f32, squares: f32, products: f32, patch: &Patch) -> f32 {
    let variance = squares - sum * sum;
    if variance < MIN_VARIANCE {
        return 1.0;
    }
    1.0 - products * patch.inverse_deviation / variance.sqrt()
}
