//! Detection and sub-sample refinement of extrema of the difference of Gaussians in scale space.
//!
//! Lowe 2004, section 4, with the constants of VLFeat. A candidate is strictly above or strictly
//! below its 26 neighbours, with an absolute value of at least 0.8 of the peak threshold.
//! Refinement fits a quadratic up to five times and moves by at most one sample in x and y between
//! the fits. The interpolated value must pass the peak threshold, and the principal curvatures the
//! edge threshold (section 4.1).

use crate::buffer::Ring;
use crate::scale_space::sigma_at;
use crate::simd::{LANES, Simd};

/// Maximum number of quadratic fits. Refinement moves by at most one sample between two fits.
const MAX_FITS: usize = 5;
/// Radius, in samples, of the neighbourhood that a refinement reads.
pub(crate) const REFINEMENT_RADIUS: usize = MAX_FITS;
/// Minimum value of a candidate before refinement, relative to the peak threshold.
const CANDIDATE_RATIO: f32 = 0.8;
/// Refinement moves to the next sample if the offset exceeds this.
const MOVE_OFFSET: f64 = 0.6;
/// Maximum offset of a refined extremum from its sample.
const MAX_OFFSET: f64 = 1.5;
/// The Hessian counts as singular if a pivot is smaller. The offset is then zero.
const MIN_PIVOT: f64 = 1e-10;

/// Thresholds of the refined extrema.
#[derive(Clone, Copy)]
pub(crate) struct Thresholds {
    /// Minimum absolute value of the difference of Gaussians.
    pub(crate) peak: f32,
    /// Maximum ratio of the principal curvatures.
    pub(crate) edge: f32,
}

/// A refined extremum. Coordinates and lengths are in samples of its octave; the origin is the
/// centre of the first sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Extremum {
    /// Index of the octave: log2 of the sample distance in pixels.
    pub(crate) octave: i32,
    /// Level of detection, 1 … S, whose gradients give the descriptor.
    pub(crate) level: usize,
    /// Column of the sample.
    pub(crate) ix: usize,
    /// Row of the sample.
    pub(crate) iy: usize,
    /// Refined column.
    pub(crate) x: f32,
    /// Refined row.
    pub(crate) y: f32,
    /// Refined scale σ.
    pub(crate) sigma: f32,
    /// Absolute value of the interpolated difference of Gaussians.
    pub(crate) response: f32,
}

/// Detects extrema in a tile, row by row.
pub(crate) struct Detector<'a> {
    /// The differences of Gaussians D_0 … D_{S+1}.
    pub(crate) differences: &'a [Ring],
    /// Position of the first column of the tile in a row.
    pub(crate) origin: usize,
    /// Columns of the tile.
    pub(crate) columns: (usize, usize),
    /// Width and height of the octave.
    pub(crate) size: (usize, usize),
    /// Index of the octave.
    pub(crate) octave: i32,
    /// Number S of levels in which extrema are detected.
    pub(crate) levels: usize,
    /// Thresholds of the refined extrema.
    pub(crate) thresholds: Thresholds,
}

impl Detector<'_> {
    /// Appends the refined extrema of row `y`, ordered by level and column.
    #[inline(always)]
    pub(crate) fn detect_row<S: Simd>(&self, y: usize, found: &mut Vec<Extremum>) {
        let (width, height) = self.size;
        if y == 0 || y + 1 >= height {
            return;
        }
        let (first, end) = (self.columns.0.max(1), self.columns.1.min(width - 1));
        let min_value = self.thresholds.peak * CANDIDATE_RATIO;
        for level in 1..=self.levels {
            let ring = &self.differences[level];
            let (above, row, below) = (ring.row(y - 1), ring.row(y), ring.row(y + 1));
            let mut block = self.columns.0;
            while block < end {
                let at = block - self.columns.0 + self.origin;
                // SAFETY: a row holds the columns of the tile, their neighbours and the slack for
                // vector loads.
                let mut mask = unsafe {
                    peaks_in_plane::<S>(above.add(at), row.add(at), below.add(at), min_value)
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

    /// D_i at a sample of the tile or its halo.
    #[inline(always)]
    fn at(&self, x: usize, y: usize, i: usize) -> f32 {
        self.differences[i].values(y)[x + self.origin - self.columns.0]
    }

    /// Whether a sample is strictly above or strictly below its 26 neighbours.
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

    /// Refines a candidate by quadratic fits (Brown & Lowe 2002), moving to the next sample while
    /// the offset is large. `None` if the result does not pass the thresholds.
    #[inline(always)]
    fn refine(&self, mut x: usize, mut y: usize, level: usize) -> Option<Extremum> {
        let (width, height) = self.size;
        let mut fit = self.fit(x, y, level);
        for _ in 1..MAX_FITS {
            let [dx, dy, _] = fit.offset;
            let (from_x, from_y) = (x, y);
            x = next_sample(x, dx, width);
            y = next_sample(y, dy, height);
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

    /// Fits a quadratic to the neighbourhood of a sample by finite differences.
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

/// A quadratic fit around a sample.
struct Fit {
    /// Offset of the extremum from the sample: columns, rows, levels.
    offset: [f64; 3],
    /// Value at the extremum.
    value: f64,
    /// Trace of the Hessian in x and y.
    trace: f64,
    /// Determinant of the Hessian in x and y.
    determinant: f64,
}

/// The neighbouring sample in the direction of a large offset, except at the border.
#[inline(always)]
fn next_sample(x: usize, offset: f64, size: usize) -> usize {
    if offset > MOVE_OFFSET && x + 2 < size {
        x + 1
    } else if offset < -MOVE_OFFSET && x > 1 {
        x - 1
    } else {
        x
    }
}

/// Bit mask of the lanes that pass the threshold and are above or below their four neighbours in
/// the same difference of Gaussians.
///
/// # Safety
/// All three rows are readable from one value before the pointer to one value after the vector.
#[inline(always)]
unsafe fn peaks_in_plane<S: Simd>(
    above: *const f32,
    row: *const f32,
    below: *const f32,
    min_value: f32,
) -> u32 {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let value = S::load(row);
        let strong = !S::mask_lt(S::abs(value), S::splat(min_value)) & ((1 << LANES) - 1);
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

/// Solves a 3×3 system by Gaussian elimination with pivoting; `None` if it is singular.
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
