//! Dominant orientations of an extremum (Lowe 2004, section 5).
//!
//! A histogram of 36 gradient directions, weighted by the gradient magnitude and a Gaussian of 1.5
//! σ, with linear interpolation between two bins. It is smoothed six times by a box filter of width
//! three. The orientations are its highest local maxima above 80 % of the maximum, interpolated by
//! a parabola.

use crate::extrema::Extremum;
use crate::gradient::{Gradient, Level, exp_minus};
use crate::simd::{LANES, Simd};
use std::f32::consts::TAU;

/// Number of histogram bins.
const BINS: usize = 36;
/// Number of interleaved histograms: successive samples are added to different histograms.
const NUM_HISTOGRAMS: usize = 4;
/// σ of the weight, in σ of the extremum.
const WEIGHT_SIGMA: f32 = 1.5;
/// Radius of the window, in σ of the weight.
const RADIUS_IN_SIGMA: f32 = 3.0;
/// Number of smoothing passes over the histogram.
const NUM_SMOOTHINGS: usize = 6;
/// Minimum height of a local maximum, relative to the highest.
const PEAK_RATIO: f32 = 0.8;
/// Maximum number of orientations of an extremum.
pub(crate) const MAX_PEAKS: usize = 4;

/// Up to [`MAX_PEAKS`] orientations in radians, from 0 to 2π, in descending order of their maxima.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct DominantOrientations {
    angles: [f32; MAX_PEAKS],
    len: usize,
}

impl DominantOrientations {
    /// The single orientation +x.
    pub(crate) fn upright() -> Self {
        DominantOrientations { angles: [0.0; MAX_PEAKS], len: 1 }
    }

    /// The orientations.
    pub(crate) fn as_slice(&self) -> &[f32] {
        &self.angles[..self.len]
    }
}

/// The dominant orientations of an extremum, at most `max`.
#[inline(always)]
pub(crate) fn dominant_orientations<S: Simd>(
    level: &Level<'_>,
    at: &Extremum,
    max: usize,
) -> DominantOrientations {
    peaks(&smoothed(histogram::<S>(level, at)), max.min(MAX_PEAKS))
}

/// The weighted histogram of gradient directions.
#[inline(always)]
fn histogram<S: Simd>(level: &Level<'_>, at: &Extremum) -> [f32; BINS] {
    // A sample contributes to its lower and its upper bin. Lower and upper bins, and successive
    // samples, have separate histograms, so that additions do not wait for each other.
    let mut histograms = [[[0.0f32; BINS + 1]; 2]; NUM_HISTOGRAMS];
    let sigma = WEIGHT_SIGMA * at.sigma;
    let radius = (RADIUS_IN_SIGMA * sigma).floor().max(1.0);
    let (xi, yi) = (at.x.round() as usize, at.y.round() as usize);
    let reach = radius as usize;
    let (x_first, x_end) = (xi.saturating_sub(reach).max(1), (xi + reach + 1).min(level.width - 1));
    let (y_first, y_end) =
        (yi.saturating_sub(reach).max(1), (yi + reach + 1).min(level.height - 1));
    level.check_rows(y_first, y_end);
    let limit = S::splat(radius * radius + 0.6);
    let falloff = S::splat(0.5 / (sigma * sigma));
    let (zero, one) = (S::splat(0.0), S::splat(1.0));
    let mut lanes = [0.0; LANES];
    for (i, lane) in lanes.iter_mut().enumerate() {
        *lane = i as f32;
    }
    // SAFETY: arrays are loaded and stored as one vector each. Rows are checked above, and columns
    // are inside the border of the level.
    unsafe {
        let lanes = S::load(lanes.as_ptr());
        for y in y_first..y_end {
            let dy = y as f32 - at.y;
            for x in (x_first..x_end).step_by(LANES) {
                let dx = S::add(S::splat(x as f32 - at.x), lanes);
                let r2 = S::mul_add(dx, dx, S::splat(dy * dy));
                level.prefetch::<S>(x, y);
                let Gradient { magnitude, angle } = level.gradient::<S>(x, y);
                let weight = S::mul(exp_minus::<S>(S::mul(S::min(r2, limit), falloff)), magnitude);
                let weight = S::select_lt(r2, limit, weight, zero);
                // The centre of bin 0 is at half a bin. One bin is added so that indices are not
                // negative.
                let bin = S::mul_add(angle, S::splat(BINS as f32 / TAU), S::splat(0.5));
                let lower_bin = S::floor(bin);
                let upper = S::mul(S::sub(bin, lower_bin), weight);
                let lower = S::mul(S::sub(S::add(one, lower_bin), bin), weight);
                let count = LANES.min(x_end - x);
                let inside = S::splat(count as f32);
                let (mut bins, mut uppers, mut lowers) = ([0; LANES], [0.0; LANES], [0.0; LANES]);
                S::store_int(bins.as_mut_ptr(), lower_bin);
                S::store(uppers.as_mut_ptr(), S::select_lt(lanes, inside, upper, zero));
                S::store(lowers.as_mut_ptr(), S::select_lt(lanes, inside, lower, zero));
                for i in (0..count).step_by(NUM_HISTOGRAMS) {
                    for (j, [lower, upper]) in histograms.iter_mut().enumerate() {
                        // From 0 to BINS, because angles are from 0 to 2π.
                        let bin = bins[i + j] as usize;
                        debug_assert!(bin <= BINS);
                        *lower.get_unchecked_mut(bin) += lowers[i + j];
                        *upper.get_unchecked_mut(bin) += uppers[i + j];
                    }
                }
            }
        }
    }
    let [a, b, c, d] = &histograms;
    let sum = |side: usize, i: usize| (a[side][i] + b[side][i]) + (c[side][i] + d[side][i]);
    // Bin `i` is the lower bin at index `i + 1` and the upper bin at index `i`. The first lower bin
    // and the last upper bin wrap around.
    let mut histogram: [f32; BINS] = std::array::from_fn(|i| sum(0, i + 1) + sum(1, i));
    histogram[BINS - 1] += sum(0, 0);
    histogram[0] += sum(1, BINS);
    histogram
}

/// Smooths the histogram by box filters of width three.
#[inline(always)]
fn smoothed(mut histogram: [f32; BINS]) -> [f32; BINS] {
    for _ in 0..NUM_SMOOTHINGS {
        let h = histogram;
        for i in 0..BINS {
            histogram[i] = (h[(i + BINS - 1) % BINS] + h[i] + h[(i + 1) % BINS]) / 3.0;
        }
    }
    histogram
}

/// The highest local maxima of the histogram, at most `max`.
#[inline(always)]
fn peaks(histogram: &[f32; BINS], max: usize) -> DominantOrientations {
    let highest = histogram.iter().fold(0.0f32, |a, &b| a.max(b));
    let mut found = DominantOrientations::default();
    let mut heights = [0.0; MAX_PEAKS];
    for i in 0..BINS {
        let (before, here, after) =
            (histogram[(i + BINS - 1) % BINS], histogram[i], histogram[(i + 1) % BINS]);
        if here <= PEAK_RATIO * highest || here <= before || here <= after {
            continue;
        }
        let offset = -0.5 * (after - before) / (after + before - 2.0 * here);
        // Insert after all maxima that are at least as high.
        let place = heights[..found.len].iter().position(|&h| h < here).unwrap_or(found.len);
        if place >= max {
            continue;
        }
        found.len = (found.len + 1).min(max);
        for j in (place + 1..found.len).rev() {
            heights[j] = heights[j - 1];
            found.angles[j] = found.angles[j - 1];
        }
        heights[place] = here;
        found.angles[place] = (i as f32 + offset + 0.5) * (TAU / BINS as f32);
    }
    found
}
