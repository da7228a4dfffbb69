//! Gradients of a level in polar form, sixteen samples at a time.

use crate::simd::{LANES, Simd};
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// A stored level of an octave.
#[derive(Clone, Copy)]
pub(crate) struct Level<'a> {
    /// The stored rows, followed by at least two vectors of slack.
    pub(crate) data: &'a [f32],
    /// Distance between rows, in samples.
    pub(crate) stride: usize,
    /// Number of columns.
    pub(crate) width: usize,
    /// Number of rows of the level.
    pub(crate) height: usize,
    /// Index of the first stored row.
    pub(crate) first_row: usize,
}

/// Gradients at sixteen successive samples of a row.
pub(crate) struct Gradient<S: Simd> {
    /// Magnitude, in grey values per sample.
    pub(crate) magnitude: S::F,
    /// Direction from +x towards +y, in radians, from 0 up to 2π.
    pub(crate) angle: S::F,
}

/// Prefetch distance in rows: the hardware prefetcher does not follow strides of a whole row.
const ROWS_AHEAD: usize = 8;

impl Level<'_> {
    /// Prefetches the samples [`ROWS_AHEAD`] rows below (x, y).
    #[inline(always)]
    pub(crate) fn prefetch<S: Simd>(&self, x: usize, y: usize) {
        let at = (y + ROWS_AHEAD - self.first_row) * self.stride + x;
        S::prefetch(self.data.as_ptr().wrapping_add(at));
    }

    /// Checks that the gradients of rows `first..end` can be computed.
    ///
    /// # Panics
    /// If one of these rows, or the row above or below it, is not stored.
    #[inline(always)]
    pub(crate) fn check_rows(&self, first: usize, end: usize) {
        if first < end {
            let len = (end - self.first_row) * self.stride + self.width + LANES;
            assert!(
                first > self.first_row && len <= self.data.len(),
                "rows {first}..{end} of a level"
            );
        }
    }

    /// Gradients at the samples from (x, y) on, by central differences.
    ///
    /// # Safety
    /// (x, y) is not in the first or last column, and [`check_rows`](Self::check_rows) succeeded
    /// for row y.
    #[inline(always)]
    pub(crate) unsafe fn gradient<S: Simd>(&self, x: usize, y: usize) -> Gradient<S> {
        let at = (y - self.first_row) * self.stride + x;
        debug_assert!(x > 0 && y > self.first_row && x + 1 < self.width && y + 1 < self.height);
        debug_assert!(at + self.stride + LANES <= self.data.len());
        // SAFETY: the rows above and below are stored, and two vectors of slack follow the rows.
        let (left, right, up, down) = unsafe {
            let p = self.data.as_ptr().add(at);
            (
                S::load(p.sub(1)),
                S::load(p.add(1)),
                S::load(p.sub(self.stride)),
                S::load(p.add(self.stride)),
            )
        };
        let half = S::splat(0.5);
        let (gx, gy) = (S::mul(S::sub(right, left), half), S::mul(S::sub(down, up), half));
        Gradient {
            magnitude: S::sqrt(S::mul_add(gx, gx, S::mul(gy, gy))),
            angle: angle::<S>(gy, gx),
        }
    }
}

/// Minimax polynomial of atan(√s)/√s on [0, 1]. The error of atan is at most 2.5e-7.
const ATAN: [f32; 7] = [
    0.999_996_1,
    -0.333_173_7,
    0.198_078_22,
    -0.132_333_65,
    0.079_624_07,
    -0.033_604_555,
    0.006_811_9,
];

/// atan2 in [0, 2π]. Zero for a zero vector.
#[inline(always)]
fn angle<S: Simd>(y: S::F, x: S::F) -> S::F {
    let (ax, ay) = (S::abs(x), S::abs(y));
    let (small, large) = (S::min(ax, ay), S::max(ax, ay));
    let a = S::div(small, S::max(large, S::splat(f32::MIN_POSITIVE)));
    let s = S::mul(a, a);
    let mut p = S::splat(ATAN[ATAN.len() - 1]);
    for &c in ATAN[..ATAN.len() - 1].iter().rev() {
        p = S::mul_add(p, s, S::splat(c));
    }
    let octant_angle = S::mul(p, a);
    let zero = S::splat(0.0);
    let quadrant_angle =
        S::select_lt(ax, ay, S::sub(S::splat(FRAC_PI_2), octant_angle), octant_angle);
    let half = S::select_lt(x, zero, S::sub(S::splat(PI), quadrant_angle), quadrant_angle);
    S::select_lt(y, zero, S::sub(S::splat(TAU), half), half)
}

/// Minimax polynomial of exp(−u) on [0, 0.7]. The error is at most 6e-8.
const EXP: [f32; 6] =
    [0.999_999_94, -0.999_994_1, 0.499_899_66, -0.166_040_5, 0.039_879_1, -0.005_906_740_7];

/// exp(−t) for t from 0 to 5.6.
#[inline(always)]
pub(crate) fn exp_minus<S: Simd>(t: S::F) -> S::F {
    let u = S::mul(t, S::splat(0.125));
    let mut p = S::splat(EXP[EXP.len() - 1]);
    for &c in EXP[..EXP.len() - 1].iter().rev() {
        p = S::mul_add(p, u, S::splat(c));
    }
    let p2 = S::mul(p, p);
    let p4 = S::mul(p2, p2);
    S::mul(p4, p4)
}
