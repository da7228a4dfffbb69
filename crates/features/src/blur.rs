//! Separable Gaussian blur: convolution along columns and along rows.
//!
//! The convolution along columns computes a block of output rows at a time, and loads each input
//! row once per block. The convolution along rows uses the symmetry of the kernel. Sums are in the
//! order of the kernel, so the result does not depend on the vector width.

use crate::simd::{LANES, Simd};

/// Output rows that [`blur_columns`] computes from one pass over its input rows.
pub(crate) const BLOCK: usize = 4;

/// Blurs along columns: `out[j][x] = Σ_t kernel[|t − radius|] · rows[j + t][x]` for `x` in
/// `from..to` and t = 0 … 2 · radius. `kernel` is one half of the symmetric kernel, from its centre
/// to its end: radius + 1 values.
///
/// # Safety
/// `rows` has `2 · radius + ROWS` entries. Whole vectors are read and written: rows are readable
/// and `out` is writable from `from`, over `to − from` rounded up to a multiple of `2 · LANES`.
#[inline(always)]
pub(crate) unsafe fn blur_columns<S: Simd, const ROWS: usize>(
    rows: &[*const f32],
    kernel: &[f32],
    out: [*mut f32; ROWS],
    (from, to): (usize, usize),
) {
    // SAFETY: guaranteed by the caller.
    unsafe {
        if S::UNROLL == 2 {
            blur_columns_unrolled::<S, ROWS, 2>(rows, kernel, out, (from, to));
        } else {
            blur_columns_unrolled::<S, ROWS, 1>(rows, kernel, out, (from, to));
        }
    }
}

/// [`blur_columns`] with `UNROLL` vectors per iteration.
///
/// # Safety
/// As [`blur_columns`].
#[inline(always)]
unsafe fn blur_columns_unrolled<S: Simd, const ROWS: usize, const UNROLL: usize>(
    rows: &[*const f32],
    kernel: &[f32],
    out: [*mut f32; ROWS],
    (from, to): (usize, usize),
) {
    let radius = kernel.len() - 1;
    debug_assert!(rows.len() == 2 * radius + ROWS && 2 * radius >= ROWS);
    let mut x = from;
    while x < to {
        let mut sums = [[S::splat(0.0); UNROLL]; ROWS];
        // SAFETY: guaranteed by the caller; taps below are within `rows` and `kernel`.
        unsafe {
            let tap = |t: usize, j: usize| *kernel.get_unchecked((t - j).abs_diff(radius));
            for t in 0..ROWS - 1 {
                let row = rows.get_unchecked(t).add(x);
                for (j, sums) in sums.iter_mut().enumerate() {
                    if j <= t {
                        multiply_add::<S, UNROLL>(sums, row, tap(t, j));
                    }
                }
            }
            for t in ROWS - 1..=2 * radius {
                let row = rows.get_unchecked(t).add(x);
                for (j, sums) in sums.iter_mut().enumerate() {
                    multiply_add::<S, UNROLL>(sums, row, tap(t, j));
                }
            }
            for last in 1..ROWS {
                let row = rows.get_unchecked(2 * radius + last).add(x);
                for (j, sums) in sums.iter_mut().enumerate() {
                    if j >= last {
                        multiply_add::<S, UNROLL>(sums, row, tap(2 * radius + last, j));
                    }
                }
            }
            for (sums, out) in sums.iter().zip(out) {
                for (b, &sum) in sums.iter().enumerate() {
                    S::store(out.add(x + b * LANES), sum);
                }
            }
        }
        x += UNROLL * LANES;
    }
}

/// Adds a row times a weight to `UNROLL` vectors of sums.
///
/// # Safety
/// `row` is readable for `UNROLL` vectors.
#[inline(always)]
unsafe fn multiply_add<S: Simd, const UNROLL: usize>(
    sums: &mut [S::F; UNROLL],
    row: *const f32,
    weight: f32,
) {
    let weight = S::splat(weight);
    for (b, sum) in sums.iter_mut().enumerate() {
        // SAFETY: guaranteed by the caller.
        *sum = unsafe { S::mul_add(S::load(row.add(b * LANES)), weight, *sum) };
    }
}

/// Number of vectors that [`blur_row`] computes per iteration.
const ROW_UNROLL: usize = 4;

/// Blurs along a row: `out[x] = Σ_t kernel[|t|] · row[x + t]` for `x` in `columns`. If `difference`
/// is `(below, difference)`, also writes `difference[x] = out[x] − below[x]`.
///
/// # Safety
/// `columns` is `from..to`, and `from` is a multiple of `LANES`. With m = max(radius, `LANES`),
/// `row` is readable from `from − m` to `to + m + 4 · LANES`. The other pointers are accessible
/// from `from` to `to + 4 · LANES`.
#[inline(always)]
pub(crate) unsafe fn blur_row<S: Simd>(
    row: *const f32,
    kernel: &[f32],
    out: *mut f32,
    difference: Option<(*const f32, *mut f32)>,
    columns: (usize, usize),
) {
    // SAFETY: guaranteed by the caller.
    unsafe {
        // Specialised for the radii of three levels per octave, the default.
        match kernel.len() - 1 {
            5 => blur_row_with_radius::<S, 5>(row, kernel, out, difference, columns),
            7 => blur_row_with_radius::<S, 7>(row, kernel, out, difference, columns),
            8 => blur_row_with_radius::<S, 8>(row, kernel, out, difference, columns),
            10 => blur_row_with_radius::<S, 10>(row, kernel, out, difference, columns),
            13 => blur_row_with_radius::<S, 13>(row, kernel, out, difference, columns),
            _ => blur_row_with_radius::<S, ANY>(row, kernel, out, difference, columns),
        }
    }
}

/// Value of `RADIUS` for kernels of any radius.
const ANY: usize = 0;

/// Adds the two taps at distance `RIGHT = 16 − LEFT`. The vectors and their neighbours are in
/// registers.
///
/// # Safety
/// As [`blur_row`]; `near` holds the vectors from one vector before `row` on.
#[inline(always)]
unsafe fn add_taps<S: Simd, const LEFT: i32, const RIGHT: i32>(
    row: *const f32,
    near: &[S::F; ROW_UNROLL + 2],
    weight: f32,
    sums: &mut [S::F; ROW_UNROLL],
) {
    let weight = S::splat(weight);
    for (b, sum) in sums.iter_mut().enumerate() {
        // SAFETY: guaranteed by the caller.
        unsafe {
            let at = row.add(b * LANES);
            let left = S::load_between::<LEFT>(at.sub(RIGHT as usize), near[b], near[b + 1]);
            let right = S::load_between::<RIGHT>(at.add(RIGHT as usize), near[b + 1], near[b + 2]);
            *sum = S::mul_add(S::add(left, right), weight, *sum);
        }
    }
}

/// [`blur_row`] with a constant radius.
///
/// # Safety
/// As [`blur_row`], and `RADIUS` is that of the kernel, or [`ANY`].
#[inline(always)]
unsafe fn blur_row_with_radius<S: Simd, const RADIUS: usize>(
    row: *const f32,
    kernel: &[f32],
    out: *mut f32,
    difference: Option<(*const f32, *mut f32)>,
    (from, to): (usize, usize),
) {
    let mut x = from;
    while x < to {
        // SAFETY: guaranteed by the caller.
        unsafe {
            let mut near = [S::splat(0.0); ROW_UNROLL + 2];
            for (b, near) in near.iter_mut().enumerate() {
                *near = S::load(row.add(x + b * LANES).sub(LANES));
            }
            let mut sums = [S::splat(*kernel.get_unchecked(0)); ROW_UNROLL];
            for (b, sum) in sums.iter_mut().enumerate() {
                *sum = S::mul(near[b + 1], *sum);
            }
            if RADIUS == ANY {
                for (t, &weight) in kernel.iter().enumerate().skip(1) {
                    let weight = S::splat(weight);
                    for (b, sum) in sums.iter_mut().enumerate() {
                        let at = row.add(x + b * LANES);
                        let pair = S::add(S::load(at.sub(t)), S::load(at.add(t)));
                        *sum = S::mul_add(pair, weight, *sum);
                    }
                }
            } else {
                let at = row.add(x);
                let weight = |t: usize| *kernel.get_unchecked(t);
                if RADIUS >= 1 {
                    add_taps::<S, 15, 1>(at, &near, weight(1), &mut sums);
                }
                if RADIUS >= 2 {
                    add_taps::<S, 14, 2>(at, &near, weight(2), &mut sums);
                }
                if RADIUS >= 3 {
                    add_taps::<S, 13, 3>(at, &near, weight(3), &mut sums);
                }
                if RADIUS >= 4 {
                    add_taps::<S, 12, 4>(at, &near, weight(4), &mut sums);
                }
                if RADIUS >= 5 {
                    add_taps::<S, 11, 5>(at, &near, weight(5), &mut sums);
                }
                if RADIUS >= 6 {
                    add_taps::<S, 10, 6>(at, &near, weight(6), &mut sums);
                }
                if RADIUS >= 7 {
                    add_taps::<S, 9, 7>(at, &near, weight(7), &mut sums);
                }
                if RADIUS >= 8 {
                    add_taps::<S, 8, 8>(at, &near, weight(8), &mut sums);
                }
                if RADIUS >= 9 {
                    add_taps::<S, 7, 9>(at, &near, weight(9), &mut sums);
                }
                if RADIUS >= 10 {
                    add_taps::<S, 6, 10>(at, &near, weight(10), &mut sums);
                }
                if RADIUS >= 11 {
                    add_taps::<S, 5, 11>(at, &near, weight(11), &mut sums);
                }
                if RADIUS >= 12 {
                    add_taps::<S, 4, 12>(at, &near, weight(12), &mut sums);
                }
                if RADIUS >= 13 {
                    add_taps::<S, 3, 13>(at, &near, weight(13), &mut sums);
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
        x += ROW_UNROLL * LANES;
    }
}
