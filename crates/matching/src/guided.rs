//! Guided matching along epipolar lines.
//!
//! With a known fundamental matrix, only keypoints near the epipolar line are candidates. The ratio
//! test then has fewer candidates, and repeated structures can be distinguished. A pair is a
//! candidate if each keypoint is within `max_error_px` of the epipolar line of the other: `(x_bᵀ F
//! x_a)² ≤ e² min(|F x_a|²₁₂, |Fᵀ x_b|²₁₂)`, where `|·|₁₂` is the length of the normal of a line.
//! There are no candidates near an epipole, where the lines are undefined.
//!
//! The keypoints of the second image are sorted into strips across the line, and into cells along
//! each strip. A line intersects a short range of cells in each strip.

use tiepoint_features::{Features, Keypoint};

use crate::any_kind::AnyKind;
use crate::brute::NearestBothWays;
use crate::distance::squared_distance;
use crate::match_sift::select;
use crate::matches::{Match, Nearest};
use crate::options::Options;

/// Number of strips of the second image.
const STRIPS: usize = 32;
/// Number of cells of a strip.
const CELLS: usize = 256;
/// Margin of the ranges of cells, larger than the rounding error. The exact test follows.
const MARGIN_PX: f64 = 1e-3;

/// The epipolar geometry of two images for guided matching.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EpipolarGuide {
    /// The fundamental matrix `F` of `x_bᵀ F x_a = 0`, row by row, in pixels, of any scale.
    pub fundamental: [[f64; 3]; 3],
    /// Maximum distance of a keypoint to its epipolar line, in pixels, in both images.
    pub max_error_px: f64,
}

/// Matches two images of known epipolar geometry. Matches are in ascending order of `a`.
/// `options.method` and `options.preempt` have no effect.
pub fn match_guided(
    a: &Features,
    b: &Features,
    guide: &EpipolarGuide,
    options: &Options,
) -> Vec<Match> {
    if a.descriptors.format() != b.descriptors.format() {
        return Vec::new();
    }
    let (Some(sift_a), Some(sift_b)) = (a.descriptors.as_sift(), b.descriptors.as_sift()) else {
        let [any_a, any_b] = [a, b].map(|f| AnyKind::new(f.descriptors.clone(), None));
        return any_a.matches_among(&any_b, options, |take| for_each_candidate(a, b, guide, take));
    };
    let mut of_a = vec![Nearest::NONE; sift_a.len()];
    let mut of_b = vec![Nearest::NONE; sift_b.len()];
    for_each_candidate(a, b, guide, |i, j| {
        let distance = squared_distance(&sift_a[i], &sift_b[j]);
        of_a[i].update(j as u32, distance);
        of_b[j].update(i as u32, distance);
    });
    select(&NearestBothWays { of_a, of_b }, options)
}

/// Passes the indices of all candidates to `take`.
fn for_each_candidate(
    a: &Features,
    b: &Features,
    guide: &EpipolarGuide,
    mut take: impl FnMut(usize, usize),
) {
    let strips = [Strips::new(b, guide, 0), Strips::new(b, guide, 1)];
    let max_error_squared = guide.max_error_px * guide.max_error_px;
    for (i, keypoint) in a.keypoints.iter().take(a.descriptors.len()).enumerate() {
        let line = line_in_b(&guide.fundamental, keypoint);
        let normal_squared = line[0] * line[0] + line[1] * line[1];
        // Strips divide the axis along which the line is longer.
        let axis = usize::from(line[0].abs() > line[1].abs());
        strips[axis].for_each_near(line, guide.max_error_px, |candidate| {
            let product = line[0] * candidate.x + line[1] * candidate.y + line[2];
            let allowed = max_error_squared * normal_squared.min(candidate.normal_squared);
            if allowed > 0.0 && product * product <= allowed {
                take(i, candidate.index as usize);
            }
        });
    }
}

/// A keypoint of the second image.
struct Candidate {
    x: f64,
    y: f64,
    index: u32,
    /// Squared length of the normal of the epipolar line in the first image.
    normal_squared: f64,
}

/// Keypoints of the second image, sorted into strips along one axis and cells along the other.
struct Strips {
    /// The axis of the strips: 0 for x, 1 for y.
    axis: usize,
    strips: Bins<STRIPS>,
    cells: Bins<CELLS>,
    /// Index of the first candidate of every cell, strip by strip, and the number of candidates.
    starts: Vec<usize>,
    candidates: Vec<Candidate>,
}

/// A division of an interval into `N` equal bins.
struct Bins<const N: usize> {
    origin: f64,
    width: f64,
}

impl<const N: usize> Bins<N> {
    fn over(values: impl Iterator<Item = f64>) -> Self {
        let (low, high) = values
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        Bins { origin: low, width: ((high - low) / N as f64).max(1.0) }
    }

    /// The bin of `x`; the first or last bin if `x` is outside the interval.
    fn bin(&self, x: f64) -> usize {
        (((x - self.origin) / self.width) as usize).min(N - 1)
    }
}

impl Candidate {
    /// The coordinate along an axis.
    fn along(&self, axis: usize) -> f64 {
        [self.x, self.y][axis]
    }
}

impl Strips {
    fn new(b: &Features, guide: &EpipolarGuide, axis: usize) -> Self {
        let mut candidates: Vec<Candidate> =
            (b.keypoints.iter().take(b.descriptors.len()).enumerate())
                .filter(|(_, keypoint)| keypoint.x.is_finite() && keypoint.y.is_finite())
                .map(|(index, keypoint)| Candidate {
                    x: f64::from(keypoint.x),
                    y: f64::from(keypoint.y),
                    index: index as u32,
                    normal_squared: normal_squared_in_a(&guide.fundamental, keypoint),
                })
                .collect();
        let strips = Bins::<STRIPS>::over(candidates.iter().map(|c| c.along(axis)));
        let cells = Bins::<CELLS>::over(candidates.iter().map(|c| c.along(1 - axis)));
        let cell_index =
            |c: &Candidate| strips.bin(c.along(axis)) * CELLS + cells.bin(c.along(1 - axis));
        candidates.sort_by_key(cell_index);
        let mut starts = vec![0; STRIPS * CELLS + 1];
        for candidate in &candidates {
            starts[cell_index(candidate) + 1] += 1;
        }
        for cell_index in 0..STRIPS * CELLS {
            starts[cell_index + 1] += starts[cell_index];
        }
        Strips { axis, strips, cells, starts, candidates }
    }

    /// Calls `visit` for all candidates within `max_error_px` of the line, and for some others.
    fn for_each_near(&self, line: [f64; 3], max_error_px: f64, mut visit: impl FnMut(&Candidate)) {
        let (slope, offset) =
            (-line[self.axis] / line[1 - self.axis], -line[2] / line[1 - self.axis]);
        let margin = max_error_px * (1.0 + slope * slope).sqrt() + MARGIN_PX;
        let end_of_cells = self.cells.origin + self.cells.width * CELLS as f64;
        for strip in 0..STRIPS {
            let start = self.strips.origin + self.strips.width * strip as f64;
            let (p, q) = (slope * start + offset, slope * (start + self.strips.width) + offset);
            let (low, high) = (p.min(q) - margin, p.max(q) + margin);
            if high < self.cells.origin || low > end_of_cells {
                continue;
            }
            let cells =
                strip * CELLS + self.cells.bin(low)..strip * CELLS + self.cells.bin(high) + 1;
            self.candidates[self.starts[cells.start]..self.starts[cells.end]]
                .iter()
                .for_each(&mut visit);
        }
    }
}

/// The epipolar line `F x_a`.
fn line_in_b(f: &[[f64; 3]; 3], keypoint: &Keypoint) -> [f64; 3] {
    let (x, y) = (f64::from(keypoint.x), f64::from(keypoint.y));
    f.map(|row| row[0] * x + row[1] * y + row[2])
}

/// Squared length of the first two entries of `Fᵀ x_b`.
fn normal_squared_in_a(f: &[[f64; 3]; 3], keypoint: &Keypoint) -> f64 {
    let (x, y) = (f64::from(keypoint.x), f64::from(keypoint.y));
    (0..2).map(|k| (f[0][k] * x + f[1][k] * y + f[2][k]).powi(2)).sum()
}

#[cfg(test)]
mod tests;
