//! Products of a landmark's Y with vectors over the kept variables.

use super::simd::{Isa, Kernel, LANES, Stored, Vector, run_narrow};
use crate::structure::PatternBlock;

/// step += Y δ_c of one landmark.
#[inline(always)]
fn multiply_with<I: Isa, T: Stored>(
    y: &[T],
    pattern_blocks: &[PatternBlock],
    kept: &[f64],
    step: &mut [f64],
) {
    match step.len() {
        1 => multiply_rows::<1, I, T>(y, pattern_blocks, kept, step),
        2 => multiply_rows::<2, I, T>(y, pattern_blocks, kept, step),
        3 => multiply_rows::<3, I, T>(y, pattern_blocks, kept, step),
        4 => multiply_rows::<4, I, T>(y, pattern_blocks, kept, step),
        5 => multiply_rows::<5, I, T>(y, pattern_blocks, kept, step),
        _ => multiply_rows::<6, I, T>(y, pattern_blocks, kept, step),
    }
}

#[inline(always)]
fn multiply_rows<const P: usize, I: Isa, T: Stored>(
    y: &[T],
    pattern_blocks: &[PatternBlock],
    kept: &[f64],
    step: &mut [f64],
) {
    let mut sums = [I::Narrow::splat(0.0); P];
    for pattern_block in pattern_blocks {
        // Beyond the end of a row, Y holds the next row and δ_c holds zeros.
        let y = &y[P * pattern_block.packed_offset..]
            [..(P - 1) * pattern_block.dof + pattern_block.padded];
        let kept = &kept[pattern_block.vector_offset..][..pattern_block.padded];
        for lane in (0..pattern_block.padded).step_by(LANES) {
            let kept = I::Narrow::load(&kept[lane..]);
            for k in 0..P {
                sums[k] =
                    T::load::<I::Narrow>(&y[k * pattern_block.dof + lane..]).mul_add(kept, sums[k]);
            }
        }
    }
    for k in 0..P {
        let mut parts = [0.0; LANES];
        sums[k].store(&mut parts);
        step[k] += (parts[0] + parts[1]) + (parts[2] + parts[3]);
    }
}

/// step += Y δ_c, see [`Y`](super::stash::Y).
pub(super) fn multiply<T: Stored>(
    y: &[T],
    pattern_blocks: &[PatternBlock],
    kept: &[f64],
    step: &mut [f64],
) {
    struct Multiply<'a, T>(&'a [T], &'a [PatternBlock], &'a [f64], &'a mut [f64]);
    impl<T: Stored> Kernel for Multiply<'_, T> {
        #[inline(always)]
        fn run<I: Isa>(self) {
            multiply_with::<I, T>(self.0, self.1, self.2, self.3);
        }
    }
    run_narrow(Multiply(y, pattern_blocks, kept, step));
}

/// kept += Yᵀ u, see [`Y`](super::stash::Y).
pub(super) fn multiply_transposed<T: Stored>(
    y: &[T],
    pattern_blocks: &[PatternBlock],
    u: &[f64],
    kept: &mut [f64],
) {
    for pattern_block in pattern_blocks {
        let kept = &mut kept[pattern_block.vector_offset..][..pattern_block.dof];
        for (row, u) in
            y[u.len() * pattern_block.packed_offset..].chunks_exact(pattern_block.dof).zip(u)
        {
            kept.iter_mut().zip(row).for_each(|(kept, y)| *kept += y.number() * u);
        }
    }
}
