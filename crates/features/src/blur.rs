//! The two halves of a separable Gaussian blur, on rows.
//!
//! Columns: a block of output rows shares the input rows that it loads, so that each is read once per block.
//! Rows: the kernel is folded at its centre. Both are a few multiply-adds per loaded vector; the order of the sums is
//! that of the kernel, whatever the vector width.

use crate::simd::{LANES, Simd};

/// Output rows that [`blur_columns`] computes from one pass over its input rows.
pub(crate) const BLOCK: usize = 4;

/// Blurs along columns: `out[j][x] = Σ_t kernel[|t − radius|] · rows[j + t][x]` for `x` in `from..to`.
///
/// # Safety
/// `rows` has `2 · radius + ROWS` entries. Rows are readable and `out` is writable from `from` to `to` rounded up
/// by less than `2 · LANES`.
#[inline(always)]
pub(crate) unsafe fn blur_columns<S: Simd, const ROWS: usize>(
    rows: &[*const f32],
    kernel: &[f32],
    out: [*mut f32; ROWS],
    (from, to): (usize, usize),
) {
    // SAFETY: the caller's promise.
    unsafe {
        if S::BESIDE == 2 {
            blur_columns_beside::<S, ROWS, 2>(rows, kernel, out, (from, to));
        } else {
            blur_columns_beside::<S, ROWS, 1>(rows, kernel, out, (from, to));
        }
    }
}

#[inline(always)]
unsafe fn blur_columns_beside<S: Simd, const ROWS: usize, const BESIDE: usize>(
    rows: &[*const f32],
    kernel: &[f32],
    out: [*mut f32; ROWS],
    (from, to): (usize, usize),
) {
    let radius = kernel.len() - 1;
    debug_assert!(rows.len() == 2 * radius + ROWS && 2 * radius >= ROWS);
    let mut x = from;
    while x < to {
        let mut sums = [[S::splat(0.0); BESIDE]; ROWS];
        // SAFETY: the caller's promise; taps below stay within `rows` and `kernel`.
        unsafe {
            let tap = |t: usize, j: usize| *kernel.get_unchecked((t - j).abs_diff(radius));
            for t in 0..ROWS - 1 {
                let row = rows.get_unchecked(t).add(x);
                for (j, sums) in sums.iter_mut().enumerate() {
                    if j <= t {
                        multiply_add::<S, BESIDE>(sums, row, tap(t, j));
                    }
                }
            }
            for t in ROWS - 1..=2 * radius {
                let row = rows.get_unchecked(t).add(x);
                for (j, sums) in sums.iter_mut().enumerate() {
                    multiply_add::<S, BESIDE>(sums, row, tap(t, j));
                }
            }
            for late in 1..ROWS {
                let row = rows.get_unchecked(2 * radius + late).add(x);
                for (j, sums) in sums.iter_mut().enumerate() {
                    if j >= late {
                        multiply_add::<S, BESIDE>(sums, row, tap(2 * radius + late, j));
                    }
                }
            }
            for (sums, out) in sums.iter().zip(out) {
                for (b, &sum) in sums.iter().enumerate() {
                    S::store(out.add(x + b * LANES), sum);
                }
            }
        }
        x += BESIDE * LANES;
    }
}

/// # Safety
/// `row` is readable for `BESIDE` vectors.
#[inline(always)]
unsafe fn multiply_add<S: Simd, const BESIDE: usize>(
    sums: &mut [S::F; BESIDE],
    row: *const f32,
    weight: f32,
) {
    let weight = S::splat(weight);
    for (b, sum) in sums.iter_mut().enumerate() {
        // SAFETY: the caller's promise.
        *sum = unsafe { S::mul_add(S::load(row.add(b * LANES)), weight, *sum) };
    }
}

/// Vectors that [`blur_row`] computes beside each other.
const ROW_BESIDE: usize = 4;

/// Blurs along a row, `out[x] = Σ_t kernel[|t|] · row[x + t]` for `x` in `from..to`, and writes the difference to
/// `below` as well: `difference[x] = out[x] − below[x]`.
///
/// # Safety
/// `row` is readable from `from − radius` and all others accessible from `from`, up to `to + radius` (or `to`) rounded
/// up by less than `4 · LANES`.
#[inline(always)]
pub(crate) unsafe fn blur_row<S: Simd>(
    row: *const f32,
    kernel: &[f32],
    out: *mut f32,
    difference: Option<(*const f32, *mut f32)>,
    (from, to): (usize, usize),
) {
    let radius = kernel.len() - 1;
    let mut x = from;
    while x < to {
        // SAFETY: the caller's promise.
        unsafe {
            let centre = S::splat(*kernel.get_unchecked(0));
            let mut sums = [centre; ROW_BESIDE];
            for (b, sum) in sums.iter_mut().enumerate() {
                *sum = S::mul(S::load(row.add(x + b * LANES)), centre);
            }
            for t in 1..=radius {
                let weight = S::splat(*kernel.get_unchecked(t));
                let (left, right) = (row.add(x - t), row.add(x + t));
                for (b, sum) in sums.iter_mut().enumerate() {
                    let pair = S::add(S::load(left.add(b * LANES)), S::load(right.add(b * LANES)));
                    *sum = S::mul_add(pair, weight, *sum);
                }
            }
            for (b, &sum) in sums.iter().enumerate() {
                S::store(out.add(x + b * LANES), sum);
            }
            if let Some((below, difference)) = difference {
                for (b, &sum) in sums.iter().enumerate() {
                    let at = x + b * LANES;
                    S::store(difference.add(at), S::sub(sum, S::load(below.add(at))));
                }
            }
        }
        x += ROW_BESIDE * LANES;
    }
}
