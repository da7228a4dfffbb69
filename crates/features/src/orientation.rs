//! Dominant gradient directions around an extremum (Lowe 2004, section 5).
//!
//! A histogram of 36 directions, weighted by the gradient and by a Gaussian of 1.5 σ, each sample
//! shared by two bins; smoothed six times by a box of three; its highest local maxima that reach 80
//! % of the highest one, interpolated by a parabola.

use crate::extrema::Extremum;
use crate::gradient::{Gradient, Level, exp_minus};
use crate::simd::{LANES, Simd};
use std::f32::consts::TAU;

const BINS: usize = 36;
/// Samples that are added to a histogram each.
const BESIDE: usize = 4;
/// σ of the weight, in σ of the extremum.
const WEIGHT_SIGMA: f32 = 1.5;
/// Radius of the window, in σ of the weight.
const RADIUS: f32 = 3.0;
/// How often the histogram is smoothed.
const SMOOTHINGS: usize = 6;
/// Height of a maximum that counts, relative to the highest one.
const PEAK_SHARE: f32 = 0.8;
/// Maxima that can reach [`PEAK_SHARE`]; there are far fewer.
pub(crate) const MAX_PEAKS: usize = 4;

/// Up to [`MAX_PEAKS`] directions in radians, from 0 to 2π, the most dominant first.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Directions {
    angles: [f32; MAX_PEAKS],
    len: usize,
}

impl Directions {
    /// The direction of +x.
    pub(crate) fn upright() -> Self {
        Directions { angles: [0.0; MAX_PEAKS], len: 1 }
    }

    /// The directions.
    pub(crate) fn as_slice(&self) -> &[f32] {
        &self.angles[..self.len]
    }
}

/// The dominant directions around an extremum.
#[inline(always)]
pub(crate) fn directions<S: Simd>(level: &Level<'_>, at: &Extremum, max: usize) -> Directions {
    peaks(&smoothed(histogram::<S>(level, at)), max.min(MAX_PEAKS))
}

#[inline(always)]
fn histogram<S: Simd>(level: &Level<'_>, at: &Extremum) -> [f32; BINS] {
    // Samples are shared by the bins to both sides of them. Shares of lower and upper ones, and
    // those of neighbouring samples, are added up apart, so that none waits for the one before.
    let mut histograms = [[[0.0f32; BINS + 1]; 2]; BESIDE];
    let sigma = WEIGHT_SIGMA * at.sigma;
    let radius = (RADIUS * sigma).floor().max(1.0);
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
    // SAFETY: all loads and stores below are of arrays of one vector, or of samples in rows that
    // are checked above and in columns inside of the level's border.
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
                // The centre of bin 0 is half a bin from angle 0; one more so that no index is
                // negative.
                let bin = S::mul_add(angle, S::splat(BINS as f32 / TAU), S::splat(0.5));
                let whole = S::floor(bin);
                let upper = S::mul(S::sub(bin, whole), weight);
                let lower = S::mul(S::sub(S::add(one, whole), bin), weight);
                let count = LANES.min(x_end - x);
                let inside = S::splat(count as f32);
                let (mut bins, mut uppers, mut lowers) = ([0; LANES], [0.0; LANES], [0.0; LANES]);
                S::store_int(bins.as_mut_ptr(), whole);
                S::store(uppers.as_mut_ptr(), S::select_lt(lanes, inside, upper, zero));
                S::store(lowers.as_mut_ptr(), S::select_lt(lanes, inside, lower, zero));
                for i in (0..count).step_by(BESIDE) {
                    for (j, [lower, upper]) in histograms.iter_mut().enumerate() {
                        // From 0 to BINS, as angles are from 0 to 2π.
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
    // Bin `i` is the lower one at `i + 1` and the upper one at `i`; the first lower and the last
    // upper wrap round.
    let mut histogram: [f32; BINS] = std::array::from_fn(|i| sum(0, i + 1) + sum(1, i));
    histogram[BINS - 1] += sum(0, 0);
    histogram[0] += sum(1, BINS);
    histogram
}

#[inline(always)]
fn smoothed(mut histogram: [f32; BINS]) -> [f32; BINS] {
    for _ in 0..SMOOTHINGS {
        let h = histogram;
        for i in 0..BINS {
            histogram[i] = (h[(i + BINS - 1) % BINS] + h[i] + h[(i + 1) % BINS]) / 3.0;
        }
    }
    histogram
}

#[inline(always)]
fn peaks(histogram: &[f32; BINS], max: usize) -> Directions {
    let highest = histogram.iter().fold(0.0f32, |a, &b| a.max(b));
    let mut found = Directions::default();
    let mut heights = [0.0; MAX_PEAKS];
    for i in 0..BINS {
        let (before, here, after) =
            (histogram[(i + BINS - 1) % BINS], histogram[i], histogram[(i + 1) % BINS]);
        if here <= PEAK_SHARE * highest || here <= before || here <= after {
            continue;
        }
        let offset = -0.5 * (after - before) / (after + before - 2.0 * here);
        // Insert behind all that are at least as high.
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
