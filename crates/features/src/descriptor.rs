//! The histogram of gradients around a keypoint (Lowe 2004, section 6), normalised to 128 bytes.
//!
//! 4 × 4 cells of 3 σ by 3 σ, turned to the keypoint's orientation, and 8 directions in each. A
//! sample is shared, linearly in each dimension, by the cells and directions to both sides of it,
//! and weighted by a Gaussian with the σ of half the cells' extent. The histogram has a border of
//! one cell, which is dropped, so that nothing needs a test. Per sample, the shares of the eight
//! directions are one half of a vector, those of the next cell in x the other half, and the vector
//! is added to two rows of cells.

use crate::gradient::{Gradient, Level, exp_minus};
use crate::options::{Normalization, Options};
use crate::simd::{LANES, Simd};
use crate::types::Descriptor;
use std::f32::consts::TAU;

/// Cells along each side.
const CELLS: usize = 4;
/// Directions in a cell.
const BINS: usize = 8;
/// Side of a cell, in σ of the keypoint.
const MAGNIFICATION: f32 = 3.0;
/// Cells along each side with the border.
const PADDED: usize = CELLS + 2;
/// Samples this many cells from the centre have no weight in any cell.
const REACH: f32 = (CELLS as f32 + 1.0) / 2.0;
/// Largest share of a number in the norm of all (Lowe 2004, section 6.1).
const CLAMP: f32 = 0.2;
/// What a unit vector is scaled to, before it is rounded to bytes.
const BYTE_SCALE: f32 = 512.0;

/// Numbers of a descriptor.
const NUMBERS: usize = CELLS * CELLS * BINS;
const HISTOGRAM: usize = PADDED * PADDED * BINS;

/// Samples that are added to a histogram each: as many do not wait for each other.
const BESIDE: usize = 4;

/// In row `b`, 1 at direction `b` of both cells of a vector; then what changes that to direction
/// `b + 1`.
#[repr(align(64))]
struct OneHot([[[f32; LANES]; 2]; BINS + 1]);

static ONE_HOT: OneHot = {
    let mut rows = [[[0.0; LANES]; 2]; BINS + 1];
    let mut b = 0;
    while b <= BINS {
        let (here, next) = (b % BINS, (b + 1) % BINS);
        rows[b][0][here] = 1.0;
        rows[b][0][here + BINS] = 1.0;
        rows[b][1][here] = -1.0;
        rows[b][1][here + BINS] = -1.0;
        rows[b][1][next] = 1.0;
        rows[b][1][next + BINS] = 1.0;
        b += 1;
    }
    OneHot(rows)
};

/// Where a descriptor is measured, in samples of its octave.
#[derive(Clone, Copy)]
pub(crate) struct Frame {
    /// Column.
    pub(crate) x: f32,
    /// Row.
    pub(crate) y: f32,
    /// Scale.
    pub(crate) sigma: f32,
    /// Direction of the first axis, in radians from 0 to 2π.
    pub(crate) angle: f32,
}

/// How far the turned cells reach.
#[inline(always)]
pub(crate) fn radius_of(sigma: f32) -> f32 {
    (std::f32::consts::SQRT_2 * MAGNIFICATION * sigma * REACH + 0.5).floor()
}

/// Measures a descriptor.
#[inline(always)]
pub(crate) fn describe<S: Simd>(level: &Level<'_>, frame: Frame, options: &Options) -> Descriptor {
    let numbers = match options.domain_sizes {
        None => normalised(cells(&histogram::<S>(level, frame))),
        Some(sizes) => {
            let mut sum = [0.0; NUMBERS];
            for size in sizes.sizes() {
                let frame = Frame { sigma: size * frame.sigma, ..frame };
                let numbers = normalised(cells(&histogram::<S>(level, frame)));
                sum.iter_mut().zip(numbers).for_each(|(sum, n)| *sum += n);
            }
            divide_by_norm(&mut sum);
            sum
        }
    };
    to_bytes(numbers, options.normalization)
}

/// The histogram without its border.
#[inline(always)]
fn cells(padded: &[f32; HISTOGRAM]) -> [f32; NUMBERS] {
    let mut numbers = [0.0; NUMBERS];
    for (i, row) in numbers.chunks_exact_mut(CELLS * BINS).enumerate() {
        row.copy_from_slice(&padded[((i + 1) * PADDED + 1) * BINS..][..CELLS * BINS]);
    }
    numbers
}

#[inline(always)]
fn histogram<S: Simd>(level: &Level<'_>, frame: Frame) -> [f32; HISTOGRAM] {
    // Neighbouring samples go to different histograms: adding to a cell need not wait for the
    // sample before.
    let mut histograms = [[0.0f32; HISTOGRAM]; BESIDE];
    let (sin, cos) = frame.angle.sin_cos();
    let cell = MAGNIFICATION * frame.sigma;
    let (sin, cos) = (sin / cell, cos / cell);
    let radius = radius_of(frame.sigma);
    let (y_first, y_end) = window(frame.y, -radius, radius, level.height);
    level.check_rows(y_first, y_end);
    let limit = S::splat(REACH);
    // exp(−(u² + v²) / (2 σ²)) with σ = half of the cells.
    let falloff = S::splat(0.5 / (CELLS as f32 / 2.0).powi(2));
    let to_bins = S::splat(BINS as f32 / TAU);
    let mut lanes = [0.0; LANES];
    for (i, lane) in lanes.iter_mut().enumerate() {
        *lane = i as f32;
    }
    // SAFETY: loads and stores of arrays are of one vector each; rows are checked above, and
    // columns are inside of the level's border; the indices into the histogram are proven where
    // they are computed.
    unsafe {
        let lanes = S::load(lanes.as_ptr());
        for y in y_first..y_end {
            let dy = y as f32 - frame.y;
            // Where |u| and |v| are below `REACH` on this row.
            let (u_low, u_high) = interval(cos, sin * dy, radius);
            let (v_low, v_high) = interval(-sin, cos * dy, radius);
            let (x_first, x_end) =
                window(frame.x, u_low.max(v_low), u_high.min(v_high), level.width);
            let (u_row, v_row) = (S::splat(sin * dy), S::splat(cos * dy));
            for x in (x_first..x_end).step_by(LANES) {
                let dx = S::add(S::splat(x as f32 - frame.x), lanes);
                let u = S::mul_add(S::splat(cos), dx, u_row);
                let v = S::mul_add(S::splat(-sin), dx, v_row);
                level.prefetch::<S>(x, y);
                let Gradient { magnitude, angle } = level.gradient::<S>(x, y);
                let outside = S::max(S::abs(u), S::abs(v));
                let r2 = S::mul_add(u, u, S::mul(v, v));
                let bounded = S::min(r2, S::splat(2.0 * REACH * REACH));
                let weight = S::mul(exp_minus::<S>(S::mul(bounded, falloff)), magnitude);
                let weight = S::select_lt(outside, limit, weight, S::splat(0.0));
                let count = LANES.min(x_end - x);
                let weight = S::select_lt(lanes, S::splat(count as f32), weight, S::splat(0.0));
                // In cells, from the first cell of the border; from 0 up to below PADDED − 1.
                let u = S::add(S::max(S::min(u, limit), S::splat(-REACH)), limit);
                let v = S::add(S::max(S::min(v, limit), S::splat(-REACH)), limit);
                let most = S::splat((PADDED - 2) as f32);
                let (u_cell, v_cell) = (S::min(S::floor(u), most), S::min(S::floor(v), most));
                let (u_share, v_share) = (S::sub(u, u_cell), S::sub(v, v_cell));
                let index = S::mul_add(
                    v_cell,
                    S::splat((PADDED * BINS) as f32),
                    S::mul(u_cell, S::splat(BINS as f32)),
                );
                // Directions are relative to the keypoint's: from 0 to BINS.
                let turned = S::sub(angle, S::splat(frame.angle));
                let turned =
                    S::select_lt(turned, S::splat(0.0), S::add(turned, S::splat(TAU)), turned);
                let bin = S::mul(turned, to_bins);
                let bin_below = S::floor(bin);
                let bin_share = S::sub(bin, bin_below);
                let right = S::mul(weight, u_share);
                let samples = Samples::<S> {
                    index,
                    bin_below,
                    bin_share,
                    left: S::sub(weight, right),
                    right,
                    v_share,
                };
                let samples = samples.to_arrays();
                for i in (0..count).step_by(BESIDE) {
                    for (j, histogram) in histograms.iter_mut().enumerate() {
                        let (index, bin) =
                            (samples.index[i + j] as usize, samples.bin_below[i + j] as usize);
                        debug_assert!(index + PADDED * BINS + LANES <= HISTOGRAM && bin <= BINS);
                        let [direction, change] = ONE_HOT.0.get_unchecked(bin);
                        let share = S::splat(samples.bin_share[i + j]);
                        let shares = S::mul_add(
                            S::load(change.as_ptr()),
                            share,
                            S::load(direction.as_ptr()),
                        );
                        let shares =
                            S::mul(shares, S::halves(samples.left[i + j], samples.right[i + j]));
                        let below = S::mul(shares, S::splat(samples.v_share[i + j]));
                        let above = S::sub(shares, below);
                        let at = histogram.as_mut_ptr().add(index);
                        S::store(at, S::add(S::load(at), above));
                        let at = at.add(PADDED * BINS);
                        S::store(at, S::add(S::load(at), below));
                    }
                }
            }
        }
    }
    let [a, b, c, d] = &histograms;
    std::array::from_fn(|i| (a[i] + b[i]) + (c[i] + d[i]))
}

/// What a sample adds, for a vector of samples.
struct Samples<S: Simd> {
    /// First cell's place in the histogram.
    index: S::F,
    /// Direction below.
    bin_below: S::F,
    /// Share of the direction above.
    bin_share: S::F,
    /// Weight in the left cells.
    left: S::F,
    /// Weight in the right cells.
    right: S::F,
    /// Share of the lower cells.
    v_share: S::F,
}

struct SampleArrays {
    index: [i32; LANES],
    bin_below: [i32; LANES],
    bin_share: [f32; LANES],
    left: [f32; LANES],
    right: [f32; LANES],
    v_share: [f32; LANES],
}

impl<S: Simd> Samples<S> {
    #[inline(always)]
    fn to_arrays(&self) -> SampleArrays {
        let array = |v: S::F| {
            let mut a = [0.0; LANES];
            // SAFETY: the array is one vector long.
            unsafe { S::store(a.as_mut_ptr(), v) };
            a
        };
        let whole = |v: S::F| {
            let mut a = [0; LANES];
            // SAFETY: the array is one vector long; indices and directions are small.
            unsafe { S::store_int(a.as_mut_ptr(), v) };
            a
        };
        SampleArrays {
            index: whole(self.index),
            bin_below: whole(self.bin_below),
            bin_share: array(self.bin_share),
            left: array(self.left),
            right: array(self.right),
            v_share: array(self.v_share),
        }
    }
}

/// Where |slope · d + offset| < REACH, at most from −radius to radius.
#[inline(always)]
fn interval(slope: f32, offset: f32, radius: f32) -> (f32, f32) {
    /// Below this slope a row of any window stays on one side.
    const FLAT: f32 = 1e-6;
    if slope.abs() < FLAT {
        return if offset.abs() < REACH { (-radius, radius) } else { (1.0, 0.0) };
    }
    let (a, b) = ((-REACH - offset) / slope, (REACH - offset) / slope);
    (a.min(b).max(-radius), a.max(b).min(radius))
}

/// Samples from `centre + low` to `centre + high` that have neighbours on both sides, as a
/// half-open range.
#[inline(always)]
fn window(centre: f32, low: f32, high: f32, size: usize) -> (usize, usize) {
    let first = (centre + low).ceil().max(1.0);
    let last = (centre + high).floor().min((size - 2) as f32);
    if last < first { (1, 1) } else { (first as usize, last as usize + 1) }
}

/// Of unit length, with no number much larger than the rest.
#[inline(always)]
fn normalised(mut numbers: [f32; NUMBERS]) -> [f32; NUMBERS] {
    divide_by_norm(&mut numbers);
    for n in &mut numbers {
        *n = n.min(CLAMP);
    }
    divide_by_norm(&mut numbers);
    numbers
}

#[inline(always)]
fn to_bytes(mut numbers: [f32; NUMBERS], normalization: Normalization) -> Descriptor {
    if normalization == Normalization::RootL1 {
        let sum = sum_of(&numbers, |n| n).max(f32::MIN_POSITIVE);
        for n in &mut numbers {
            *n = (*n / sum).sqrt();
        }
    }
    let mut bytes = [0; NUMBERS];
    for (cell, out) in numbers.chunks_exact(BINS).zip(bytes.chunks_exact_mut(BINS)) {
        // Lowe's files, SiftGPU and COLMAP count directions the other way round.
        for (b, n) in cell.iter().enumerate() {
            out[(BINS - b) % BINS] = (n * BYTE_SCALE + 0.5) as u8;
        }
    }
    bytes
}

#[inline(always)]
fn divide_by_norm(numbers: &mut [f32; NUMBERS]) {
    let norm = sum_of(numbers, |n| n * n).sqrt().max(f32::MIN_POSITIVE);
    for n in numbers {
        *n /= norm;
    }
}

/// A sum in a fixed order of sixteen partial sums.
#[inline(always)]
fn sum_of(numbers: &[f32; NUMBERS], f: impl Fn(f32) -> f32) -> f32 {
    let mut sums = [0.0; LANES];
    for chunk in numbers.chunks_exact(LANES) {
        for (sum, &n) in sums.iter_mut().zip(chunk) {
            *sum += f(n);
        }
    }
    sums.iter().sum()
}
