//! The SIFT descriptor (Lowe 2004, section 6): a histogram of gradients as 128 bytes.
//!
//! The histogram has 4 × 4 cells of side 3 σ, rotated to the orientation of the keypoint, and 8
//! gradient directions per cell. A sample is weighted by a Gaussian, whose σ is half the width of
//! the 4 cells, and distributed by trilinear interpolation. The histogram is padded by one cell, so
//! that border samples need no tests. A vector of sixteen lanes holds the eight directions of two
//! cells that are adjacent in x. A sample adds one such vector to each of two rows of cells.

use std::f32::consts::TAU;

use crate::SiftDescriptor;
use crate::gradient::{Gradient, Level, exp_minus};
use crate::options::{Normalization, Options};
use crate::simd::{LANES, Simd};

/// Number of cells along each side.
const CELLS: usize = 4;
/// Number of directions per cell.
const BINS: usize = 8;
/// Side of a cell, in σ of the keypoint.
const MAGNIFICATION: f32 = 3.0;
/// Number of cells along each side with padding.
const PADDED: usize = CELLS + 2;
/// Half side of the window, in cells: samples outside have zero weight.
const HALF_WINDOW: f32 = (CELLS as f32 + 1.0) / 2.0;
/// Maximum of a value of the unit descriptor (Lowe 2004, section 6.1).
const CLAMP: f32 = 0.2;
/// Norm of a descriptor before it is rounded to bytes.
const BYTE_SCALE: f32 = 512.0;

/// Length of a descriptor.
const LEN: usize = CELLS * CELLS * BINS;
/// Length of a padded histogram.
const PADDED_LEN: usize = PADDED * PADDED * BINS;

/// Number of interleaved histograms: successive samples are added to different histograms, so that
/// additions do not wait for each other.
const NUM_HISTOGRAMS: usize = 4;

/// Row `b` holds the unit vector of direction `b`, for both cells of a vector, and the difference
/// between the unit vectors of directions `b + 1` and `b`.
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

/// Position, scale and orientation of a descriptor, in samples of its octave.
#[derive(Clone, Copy)]
pub(crate) struct Frame {
    /// Column.
    pub(crate) x: f32,
    /// Row.
    pub(crate) y: f32,
    /// Scale.
    pub(crate) sigma: f32,
    /// Direction of the x axis of the cells, in radians from 0 to 2π.
    pub(crate) angle: f32,
}

/// Radius of the window of a descriptor, in samples.
#[inline(always)]
pub(crate) fn window_radius(sigma: f32) -> f32 {
    (std::f32::consts::SQRT_2 * MAGNIFICATION * sigma * HALF_WINDOW + 0.5).floor()
}

/// Computes a descriptor.
#[inline(always)]
pub(crate) fn compute_descriptor<S: Simd>(
    level: &Level<'_>,
    frame: Frame,
    options: &Options,
) -> SiftDescriptor {
    let values = match options.domain_sizes {
        None => normalised(cells(&histogram::<S>(level, frame))),
        Some(sizes) => {
            let mut sum = [0.0; LEN];
            for size in sizes.sizes() {
                let frame = Frame { sigma: size * frame.sigma, ..frame };
                let values = normalised(cells(&histogram::<S>(level, frame)));
                sum.iter_mut().zip(values).for_each(|(sum, n)| *sum += n);
            }
            divide_by_norm(&mut sum);
            sum
        }
    };
    to_bytes(values, options.normalization)
}

/// The histogram without padding.
#[inline(always)]
fn cells(padded: &[f32; PADDED_LEN]) -> [f32; LEN] {
    let mut values = [0.0; LEN];
    for (i, row) in values.chunks_exact_mut(CELLS * BINS).enumerate() {
        row.copy_from_slice(&padded[((i + 1) * PADDED + 1) * BINS..][..CELLS * BINS]);
    }
    values
}

/// The padded histogram of gradients.
#[inline(always)]
fn histogram<S: Simd>(level: &Level<'_>, frame: Frame) -> [f32; PADDED_LEN] {
    let mut histograms = [[0.0f32; PADDED_LEN]; NUM_HISTOGRAMS];
    let (sin, cos) = frame.angle.sin_cos();
    let cell = MAGNIFICATION * frame.sigma;
    let (sin, cos) = (sin / cell, cos / cell);
    let radius = window_radius(frame.sigma);
    let (y_first, y_end) = window(frame.y, -radius, radius, level.height);
    level.check_rows(y_first, y_end);
    let limit = S::splat(HALF_WINDOW);
    // exp(−(u² + v²) / (2 σ²)) with σ = half the width of the cells.
    let falloff = S::splat(0.5 / (CELLS as f32 / 2.0).powi(2));
    let to_bins = S::splat(BINS as f32 / TAU);
    let mut lanes = [0.0; LANES];
    for (i, lane) in lanes.iter_mut().enumerate() {
        *lane = i as f32;
    }
    // SAFETY: arrays are loaded and stored as one vector each. Rows are checked above, and columns
    // are inside the border of the level. The bounds of the histogram indices are derived below.
    unsafe {
        let lanes = S::load(lanes.as_ptr());
        for y in y_first..y_end {
            let dy = y as f32 - frame.y;
            // The range of this row in which |u| and |v| are below `HALF_WINDOW`.
            let (u_low, u_high) = interval(cos, sin * dy, radius);
            let (v_low, v_high) = interval(-sin, cos * dy, radius);
            let (x_first, x_end) =
                window(frame.x, u_low.max(v_low), u_high.min(v_high), level.width);
            let (u_row, v_row) = (S::splat(sin * dy), S::splat(cos * dy));
            for x in (x_first..x_end).step_by(LANES) {
                // (u, v) is the position in cells from the keypoint, rotated to its orientation.
                let dx = S::add(S::splat(x as f32 - frame.x), lanes);
                let u = S::mul_add(S::splat(cos), dx, u_row);
                let v = S::mul_add(S::splat(-sin), dx, v_row);
                level.prefetch::<S>(x, y);
                let Gradient { magnitude, angle } = level.gradient::<S>(x, y);
                let outside = S::max(S::abs(u), S::abs(v));
                let r2 = S::mul_add(u, u, S::mul(v, v));
                let bounded = S::min(r2, S::splat(2.0 * HALF_WINDOW * HALF_WINDOW));
                let weight = S::mul(exp_minus::<S>(S::mul(bounded, falloff)), magnitude);
                let weight = S::select_lt(outside, limit, weight, S::splat(0.0));
                let count = LANES.min(x_end - x);
                let weight = S::select_lt(lanes, S::splat(count as f32), weight, S::splat(0.0));
                // In cells from the first padding cell: from 0 to below PADDED − 1.
                let u = S::add(S::max(S::min(u, limit), S::splat(-HALF_WINDOW)), limit);
                let v = S::add(S::max(S::min(v, limit), S::splat(-HALF_WINDOW)), limit);
                let max_cell = S::splat((PADDED - 2) as f32);
                let (u_cell, v_cell) =
                    (S::min(S::floor(u), max_cell), S::min(S::floor(v), max_cell));
                let (u_fraction, v_fraction) = (S::sub(u, u_cell), S::sub(v, v_cell));
                let index = S::mul_add(
                    v_cell,
                    S::splat((PADDED * BINS) as f32),
                    S::mul(u_cell, S::splat(BINS as f32)),
                );
                // Directions relative to the orientation of the keypoint, from 0 to BINS.
                let relative = S::sub(angle, S::splat(frame.angle));
                let relative = S::select_lt(
                    relative,
                    S::splat(0.0),
                    S::add(relative, S::splat(TAU)),
                    relative,
                );
                let bin = S::mul(relative, to_bins);
                let bin_below = S::floor(bin);
                let bin_fraction = S::sub(bin, bin_below);
                let right = S::mul(weight, u_fraction);
                let contributions = Contributions::<S> {
                    index,
                    bin_below,
                    bin_fraction,
                    left: S::sub(weight, right),
                    right,
                    v_fraction,
                };
                let contributions = contributions.to_arrays();
                for i in (0..count).step_by(NUM_HISTOGRAMS) {
                    for (j, histogram) in histograms.iter_mut().enumerate() {
                        let (index, bin) = (
                            contributions.index[i + j] as usize,
                            contributions.bin_below[i + j] as usize,
                        );
                        debug_assert!(index + PADDED * BINS + LANES <= PADDED_LEN && bin <= BINS);
                        // Linear interpolation between the directions `bin` and `bin + 1`.
                        let [direction, change] = ONE_HOT.0.get_unchecked(bin);
                        let fraction = S::splat(contributions.bin_fraction[i + j]);
                        let values = S::mul_add(
                            S::load(change.as_ptr()),
                            fraction,
                            S::load(direction.as_ptr()),
                        );
                        let values = S::mul(
                            values,
                            S::halves(contributions.left[i + j], contributions.right[i + j]),
                        );
                        // `above` and `below` are the parts of the upper and lower row of cells.
                        let below = S::mul(values, S::splat(contributions.v_fraction[i + j]));
                        let above = S::sub(values, below);
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

/// The contributions of a vector of samples to the histogram.
struct Contributions<S: Simd> {
    /// Index of the upper left cell in the histogram.
    index: S::F,
    /// The direction bin below the direction.
    bin_below: S::F,
    /// Interpolation weight of the next direction bin.
    bin_fraction: S::F,
    /// Weight of the left cells.
    left: S::F,
    /// Weight of the right cells.
    right: S::F,
    /// Interpolation weight of the lower cells.
    v_fraction: S::F,
}

/// [`Contributions`] as arrays.
struct ContributionArrays {
    index: [i32; LANES],
    bin_below: [i32; LANES],
    bin_fraction: [f32; LANES],
    left: [f32; LANES],
    right: [f32; LANES],
    v_fraction: [f32; LANES],
}

impl<S: Simd> Contributions<S> {
    #[inline(always)]
    fn to_arrays(&self) -> ContributionArrays {
        let array = |v: S::F| {
            let mut a = [0.0; LANES];
            // SAFETY: the array has the length of a vector.
            unsafe { S::store(a.as_mut_ptr(), v) };
            a
        };
        let to_i32 = |v: S::F| {
            let mut a = [0; LANES];
            // SAFETY: the array has the length of a vector; indices and bins are in the range of
            // `i32`.
            unsafe { S::store_int(a.as_mut_ptr(), v) };
            a
        };
        ContributionArrays {
            index: to_i32(self.index),
            bin_below: to_i32(self.bin_below),
            bin_fraction: array(self.bin_fraction),
            left: array(self.left),
            right: array(self.right),
            v_fraction: array(self.v_fraction),
        }
    }
}

/// The interval of d in [−radius, radius] with |slope · d + offset| < HALF_WINDOW.
#[inline(always)]
fn interval(slope: f32, offset: f32, radius: f32) -> (f32, f32) {
    /// Below this slope, the offset alone decides for the whole row.
    const FLAT: f32 = 1e-6;
    if slope.abs() < FLAT {
        return if offset.abs() < HALF_WINDOW { (-radius, radius) } else { (1.0, 0.0) };
    }
    let (a, b) = ((-HALF_WINDOW - offset) / slope, (HALF_WINDOW - offset) / slope);
    (a.min(b).max(-radius), a.max(b).min(radius))
}

/// The samples from `centre + low` to `centre + high` with neighbours on both sides, as a half-open
/// range.
#[inline(always)]
fn window(centre: f32, low: f32, high: f32, size: usize) -> (usize, usize) {
    let first = (centre + low).ceil().max(1.0);
    let last = (centre + high).floor().min((size - 2) as f32);
    if last < first { (1, 1) } else { (first as usize, last as usize + 1) }
}

/// Normalises to unit length with the maximum [`CLAMP`] (Lowe 2004, section 6.1).
#[inline(always)]
fn normalised(mut values: [f32; LEN]) -> [f32; LEN] {
    divide_by_norm(&mut values);
    for n in &mut values {
        *n = n.min(CLAMP);
    }
    divide_by_norm(&mut values);
    values
}

/// Converts a unit descriptor to bytes, as RootSIFT if `normalization` asks for it.
#[inline(always)]
fn to_bytes(mut values: [f32; LEN], normalization: Normalization) -> SiftDescriptor {
    if normalization == Normalization::RootL1 {
        let sum = sum_of(&values, |n| n).max(f32::MIN_POSITIVE);
        for n in &mut values {
            *n = (*n / sum).sqrt();
        }
    }
    let mut bytes = [0; LEN];
    for (cell, out) in values.chunks_exact(BINS).zip(bytes.chunks_exact_mut(BINS)) {
        // Lowe's files, SiftGPU and COLMAP have the directions in the opposite rotation sense.
        for (b, n) in cell.iter().enumerate() {
            out[(BINS - b) % BINS] = (n * BYTE_SCALE + 0.5) as u8;
        }
    }
    bytes
}

#[inline(always)]
fn divide_by_norm(values: &mut [f32; LEN]) {
    let norm = sum_of(values, |n| n * n).sqrt().max(f32::MIN_POSITIVE);
    for n in values {
        *n /= norm;
    }
}

/// A sum of sixteen partial sums, in a fixed order.
#[inline(always)]
fn sum_of(values: &[f32; LEN], f: impl Fn(f32) -> f32) -> f32 {
    let mut sums = [0.0; LANES];
    for chunk in values.chunks_exact(LANES) {
        for (sum, &n) in sums.iter_mut().zip(chunk) {
            *sum += f(n);
        }
    }
    sums.iter().sum()
}
