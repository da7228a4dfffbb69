//! Products of a cell's Y with vectors over the kept variables.

use super::simd::{Isa, LANES, Stored, Task, Vector, run_narrow};
use crate::structure::Local;

/// What back-substitution adds up for one cell: step += Y δ_c.
#[inline(always)]
fn multiply_on<I: Isa, T: Stored>(y: &[T], locals: &[Local], kept: &[f64], step: &mut [f64]) {
    match step.len() {
        1 => multiply_rows::<1, I, T>(y, locals, kept, step),
        2 => multiply_rows::<2, I, T>(y, locals, kept, step),
        3 => multiply_rows::<3, I, T>(y, locals, kept, step),
        4 => multiply_rows::<4, I, T>(y, locals, kept, step),
        5 => multiply_rows::<5, I, T>(y, locals, kept, step),
        _ => multiply_rows::<6, I, T>(y, locals, kept, step),
    }
}

#[inline(always)]
fn multiply_rows<const P: usize, I: Isa, T: Stored>(
    y: &[T],
    locals: &[Local],
    kept: &[f64],
    step: &mut [f64],
) {
    let mut sums = [I::Narrow::splat(0.0); P];
    for local in locals {
        // Beyond the end of a row, Y holds what belongs to the next one, and δ_c holds zeros.
        let y = &y[P * local.dense..][..(P - 1) * local.dof + local.padded];
        let kept = &kept[local.at..][..local.padded];
        for lane in (0..local.padded).step_by(LANES) {
            let kept = I::Narrow::load(&kept[lane..]);
            for k in 0..P {
                sums[k] = T::load::<I::Narrow>(&y[k * local.dof + lane..]).mul_add(kept, sums[k]);
            }
        }
    }
    for k in 0..P {
        let mut parts = [0.0; LANES];
        sums[k].store(&mut parts);
        step[k] += (parts[0] + parts[1]) + (parts[2] + parts[3]);
    }
}

/// See [`Y`](super::stash::Y).
pub(super) fn multiply<T: Stored>(y: &[T], locals: &[Local], kept: &[f64], step: &mut [f64]) {
    struct Multiply<'a, T>(&'a [T], &'a [Local], &'a [f64], &'a mut [f64]);
    impl<T: Stored> Task for Multiply<'_, T> {
        #[inline(always)]
        fn run<I: Isa>(self) {
            multiply_on::<I, T>(self.0, self.1, self.2, self.3);
        }
    }
    run_narrow(Multiply(y, locals, kept, step));
}

/// See [`Y`](super::stash::Y).
pub(super) fn multiply_transposed<T: Stored>(
    y: &[T],
    locals: &[Local],
    u: &[f64],
    kept: &mut [f64],
) {
    for local in locals {
        let kept = &mut kept[local.at..][..local.dof];
        for (row, u) in y[u.len() * local.dense..].chunks_exact(local.dof).zip(u) {
            kept.iter_mut().zip(row).for_each(|(kept, y)| *kept += y.number() * u);
        }
    }
}
