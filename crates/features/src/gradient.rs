//! Gradients of a level, where they are needed: sixteen samples at a time, in polar form.

use crate::simd::{LANES, Simd};
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// A stored level of an octave.
#[derive(Clone, Copy)]
pub(crate) struct Level<'a> {
    /// Samples, and at least two vectors more; rows as far as anything here is measured.
    pub(crate) data: &'a [f32],
    /// Distance between rows.
    pub(crate) stride: usize,
    /// Columns.
    pub(crate) width: usize,
    /// Rows.
    pub(crate) height: usize,
    /// The first row in `data`.
    pub(crate) first_row: usize,
}

/// Gradients at neighbouring samples of a row.
pub(crate) struct Gradient<S: Simd> {
    /// Length, in grey values per sample.
    pub(crate) magnitude: S::F,
    /// Direction from +x towards +y, in radians, from 0 up to 2π.
    pub(crate) angle: S::F,
}

/// Rows ahead that are asked for while a row is measured: the processor does not foresee steps of a
/// whole row.
const ROWS_AHEAD: usize = 8;

impl Level<'_> {
    /// Asks for the samples that are measured some rows later.
    #[inline(always)]
    pub(crate) fn prefetch<S: Simd>(&self, x: usize, y: usize) {
        let at = (y + ROWS_AHEAD - self.first_row) * self.stride + x;
        S::prefetch(self.data.as_ptr().wrapping_add(at));
    }

    /// Checks that gradients of rows `first..end` can be taken.
    ///
    /// # Panics
    /// Where one of these rows, or the one above or below it, is not stored.
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

    /// Central differences at the samples from (x, y) on.
    ///
    /// # Safety
    /// (x, y) is neither in the first nor in the last column, and [`check_rows`](Self::check_rows)
    /// has found row y.
    #[inline(always)]
    pub(crate) unsafe fn gradient<S: Simd>(&self, x: usize, y: usize) -> Gradient<S> {
        let at = (y - self.first_row) * self.stride + x;
        debug_assert!(x > 0 && y > self.first_row && x + 1 < self.width && y + 1 < self.height);
        debug_assert!(at + self.stride + LANES <= self.data.len());
        // SAFETY: rows above and below exist, and beyond the last one there is room for two
        // vectors.
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

/// Minimax polynomial of atan(√s)/√s on [0, 1]; it is within 2.5e-7 of atan.
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
    let eighth = S::mul(p, a);
    let zero = S::splat(0.0);
    let quarter = S::select_lt(ax, ay, S::sub(S::splat(FRAC_PI_2), eighth), eighth);
    let half = S::select_lt(x, zero, S::sub(S::splat(PI), quarter), quarter);
    S::select_lt(y, zero, S::sub(S::splat(TAU), half), half)
}

/// Minimax polynomial of exp(−u) on [0, 0.7], within 6e-8.
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
