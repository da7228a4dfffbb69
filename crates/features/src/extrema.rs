//! Extrema of the difference of Gaussians over space and scale, refined to a fraction of a sample.
//!
//! Lowe 2004, section 4, with the choices of VLFeat: a sample that is strictly above (below) its 26
//! neighbours and at least 0.8 of the peak threshold; up to five Newton steps, each of which may
//! move by one sample in x and y; then the interpolated value must pass the peak threshold and the
//! principal curvatures the edge threshold (section 4.1).

use crate::buffer::Ring;
use crate::scale_space::sigma_at;
use crate::simd::{LANES, Simd};

/// Newton steps. All but the first may have moved by one sample.
const STEPS: usize = 5;
/// How far a refinement reads from where it began.
pub(crate) const REACH: usize = STEPS;
/// Share of the peak threshold that a sample must reach before refinement.
const UNREFINED_SHARE: f32 = 0.8;
/// A larger offset moves to the next sample.
const MOVE_ABOVE: f64 = 0.6;
/// A larger offset after the last step is no extremum near this sample.
const MAX_OFFSET: f64 = 1.5;
/// A smaller pivot makes the Hessian singular: the sample itself is taken.
const MIN_PIVOT: f64 = 1e-10;

/// What an extremum must pass.
#[derive(Clone, Copy)]
pub(crate) struct Thresholds {
    /// Smallest absolute value.
    pub(crate) peak: f32,
    /// Largest ratio of principal curvatures.
    pub(crate) edge: f32,
}

/// A point of interest without orientation; lengths in samples of its octave, sample (0, 0) being
/// the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Extremum {
    /// log2 of the sample distance in pixels.
    pub(crate) octave: i32,
    /// Level whose gradients describe it, 1 … S.
    pub(crate) level: usize,
    /// Nearest sample.
    pub(crate) ix: usize,
    /// Nearest sample.
    pub(crate) iy: usize,
    /// Refined column.
    pub(crate) x: f32,
    /// Refined row.
    pub(crate) y: f32,
    /// Refined scale.
    pub(crate) sigma: f32,
    /// Absolute value of the interpolated difference of Gaussians.
    pub(crate) response: f32,
}

/// The differences of a tile, row by row.
pub(crate) struct Search<'a> {
    /// D_0 … D_{S+1}.
    pub(crate) differences: &'a [Ring],
    /// Position of the first column of the tile in a row.
    pub(crate) origin: usize,
    /// Columns of the tile.
    pub(crate) columns: (usize, usize),
    /// Size of the octave.
    pub(crate) size: (usize, usize),
    /// The octave.
    pub(crate) octave: i32,
    /// Scales at which extrema are looked for.
    pub(crate) levels: usize,
    /// What they must pass.
    pub(crate) thresholds: Thresholds,
}

impl Search<'_> {
    /// Appends the refined extrema that were found in row `y`, level by level and from left to
    /// right.
    #[inline(always)]
    pub(crate) fn row<S: Simd>(&self, y: usize, found: &mut Vec<Extremum>) {
        let (width, height) = self.size;
        if y == 0 || y + 1 >= height {
            return;
        }
        let (first, end) = (self.columns.0.max(1), self.columns.1.min(width - 1));
        let least = self.thresholds.peak * UNREFINED_SHARE;
        for level in 1..=self.levels {
            let ring = &self.differences[level];
            let (above, row, below) = (ring.row(y - 1), ring.row(y), ring.row(y + 1));
            let mut block = self.columns.0;
            while block < end {
                let at = block - self.columns.0 + self.origin;
                // SAFETY: a row holds the columns of the tile, its neighbours, and vectors that
                // reach beyond it.
                let mut mask = unsafe {
                    peaks_in_plane::<S>(above.add(at), row.add(at), below.add(at), least)
                };
                while mask != 0 {
                    let x = block + mask.trailing_zeros() as usize;
                    mask &= mask - 1;
                    if x < first || x >= end || !self.is_extremum(x, y, level) {
                        continue;
                    }
                    found.extend(self.refine(x, y, level));
                }
                block += LANES;
            }
        }
    }

    /// A difference at a sample of this tile or near it.
    #[inline(always)]
    fn at(&self, x: usize, y: usize, i: usize) -> f32 {
        self.differences[i].values(y)[x + self.origin - self.columns.0]
    }

    /// Whether a sample is strictly above or strictly below all its neighbours.
    #[inline(always)]
    fn is_extremum(&self, x: usize, y: usize, level: usize) -> bool {
        let value = self.at(x, y, level);
        let (mut above, mut below) = (true, true);
        for i in level - 1..=level + 1 {
            for y in [y, y - 1, y + 1].map(|row| (row, row == y)) {
                for xx in x - 1..=x + 1 {
                    if i == level && y.1 && xx == x {
                        continue;
                    }
                    let neighbour = self.at(xx, y.0, i);
                    above &= value > neighbour;
                    below &= value < neighbour;
                }
            }
            if !above && !below {
                return false;
            }
        }
        true
    }

    /// Fits a quadratic around a sample (Brown & Lowe 2002), moving along until its extremum is
    /// near.
    #[inline(always)]
    fn refine(&self, mut x: usize, mut y: usize, level: usize) -> Option<Extremum> {
        let (width, height) = self.size;
        let mut fit = self.fit(x, y, level);
        for _ in 1..STEPS {
            let [dx, dy, _] = fit.offset;
            let (from_x, from_y) = (x, y);
            x = moved(x, dx, width);
            y = moved(y, dy, height);
            if (x, y) == (from_x, from_y) {
                break;
            }
            fit = self.fit(x, y, level);
        }
        let [dx, dy, ds] = fit.offset;
        let ratio = f64::from(self.thresholds.edge);
        let edge_score = fit.trace * fit.trace / fit.determinant;
        let (x_refined, y_refined) = (x as f64 + dx, y as f64 + dy);
        let good = fit.value.abs() > f64::from(self.thresholds.peak)
            && edge_score >= 0.0
            && edge_score < (ratio + 1.0) * (ratio + 1.0) / ratio
            && [dx, dy, ds].iter().all(|d| d.abs() < MAX_OFFSET)
            && (0.0..=(width - 1) as f64).contains(&x_refined)
            && (0.0..=(height - 1) as f64).contains(&y_refined);
        good.then(|| Extremum {
            octave: self.octave,
            level,
            ix: x,
            iy: y,
            x: x_refined as f32,
            y: y_refined as f32,
            sigma: sigma_at(level as f64 + ds, self.levels) as f32,
            response: fit.value.abs() as f32,
        })
    }

    /// The quadratic through the neighbourhood of a sample.
    #[inline(always)]
    fn fit(&self, x: usize, y: usize, s: usize) -> Fit {
        let at = |dx: isize, dy: isize, ds: isize| {
            let (x, y) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
            f64::from(self.at(x, y, s.wrapping_add_signed(ds)))
        };
        let centre = at(0, 0, 0);
        let gradient = [
            0.5 * (at(1, 0, 0) - at(-1, 0, 0)),
            0.5 * (at(0, 1, 0) - at(0, -1, 0)),
            0.5 * (at(0, 0, 1) - at(0, 0, -1)),
        ];
        let xx = at(1, 0, 0) + at(-1, 0, 0) - 2.0 * centre;
        let yy = at(0, 1, 0) + at(0, -1, 0) - 2.0 * centre;
        let ss = at(0, 0, 1) + at(0, 0, -1) - 2.0 * centre;
        let xy = 0.25 * (at(1, 1, 0) + at(-1, -1, 0) - at(-1, 1, 0) - at(1, -1, 0));
        let xs = 0.25 * (at(1, 0, 1) + at(-1, 0, -1) - at(-1, 0, 1) - at(1, 0, -1));
        let ys = 0.25 * (at(0, 1, 1) + at(0, -1, -1) - at(0, -1, 1) - at(0, 1, -1));
        let offset = solve([[xx, xy, xs], [xy, yy, ys], [xs, ys, ss]], gradient.map(|g| -g))
            .unwrap_or([0.0; 3]);
        let rise = gradient[0] * offset[0] + gradient[1] * offset[1] + gradient[2] * offset[2];
        Fit { offset, value: centre + 0.5 * rise, trace: xx + yy, determinant: xx * yy - xy * xy }
    }
}

/// A quadratic around a sample.
struct Fit {
    /// Where its extremum is: columns, rows, levels.
    offset: [f64; 3],
    /// Its value there.
    value: f64,
    /// Trace of its Hessian in the plane.
    trace: f64,
    /// Determinant of its Hessian in the plane.
    determinant: f64,
}

/// The next sample if the offset points to it, unless that would touch the border.
#[inline(always)]
fn moved(x: usize, offset: f64, size: usize) -> usize {
    if offset > MOVE_ABOVE && x + 2 < size {
        x + 1
    } else if offset < -MOVE_ABOVE && x > 1 {
        x - 1
    } else {
        x
    }
}

/// Lanes that pass the threshold and are above or below their four neighbours in the same
/// difference.
///
/// # Safety
/// All three rows are readable from one value before to one vector and a value after the pointer.
#[inline(always)]
unsafe fn peaks_in_plane<S: Simd>(
    above: *const f32,
    row: *const f32,
    below: *const f32,
    least: f32,
) -> u32 {
    // SAFETY: the caller's promise.
    unsafe {
        let value = S::load(row);
        let strong = !S::mask_lt(S::abs(value), S::splat(least)) & ((1 << LANES) - 1);
        if strong == 0 {
            return 0;
        }
        let (left, right) = (S::load(row.sub(1)), S::load(row.add(1)));
        let (up, down) = (S::load(above), S::load(below));
        let highest = S::max(S::max(left, right), S::max(up, down));
        let lowest = S::min(S::min(left, right), S::min(up, down));
        strong & (S::mask_lt(highest, value) | S::mask_lt(value, lowest))
    }
}

/// Solves a symmetric system by elimination with pivoting; nothing if it is singular.
#[inline(always)]
fn solve(mut a: [[f64; 3]; 3], mut b: [f64; 3]) -> Option<[f64; 3]> {
    for j in 0..3 {
        let mut pivot = j;
        for i in j + 1..3 {
            if a[i][j].abs() > a[pivot][j].abs() {
                pivot = i;
            }
        }
        if a[pivot][j].abs() < MIN_PIVOT {
            return None;
        }
        a.swap(j, pivot);
        b.swap(j, pivot);
        for i in j + 1..3 {
            let factor = a[i][j] / a[j][j];
            let row = a[j];
            for (a, above) in a[i].iter_mut().zip(row).skip(j) {
                *a -= factor * above;
            }
            b[i] -= factor * b[j];
        }
    }
    for j in (0..3).rev() {
        for k in j + 1..3 {
            b[j] -= a[j][k] * b[k];
        }
        b[j] /= a[j][j];
    }
    Some(b)
}
