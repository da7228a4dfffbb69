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
mod constants;
mod isa;
mod kernel;
mod patch;
mod portable;
mod source;
#[cfg(test)]
mod tests;

pub(crate) use constants::OUTSIDE;
pub(crate) use isa::{Isa, dispatch};
pub(crate) use kernel::{Ncc, Task, Warp};
pub(crate) use patch::{Patch, PatchTable, RADIUS};
pub(crate) use source::Source;
