//! Matching along epipolar lines.
//!
//! With a fundamental matrix known, a feature's partner lies near a line, so the ratio test has far
//! fewer rivals and repeated structures can be told apart. A pair is a candidate where each
//! keypoint lies within `max_error_px` of the other's epipolar line:
//! `(x_bᵀ F x_a)² ≤ e² min(|F x_a|²₁₂, |Fᵀ x_b|²₁₂)`, where `|·|₁₂` is the length of a line's
//! normal. Close to an epipole, where lines are not defined, nothing is a candidate.
//!
//! Candidates are found by strips: the second image is cut into strips across the line and each
//! strip into cells, so that a line meets one short run of cells in every strip.

use tiepoint_features::{Features, Keypoint};

use crate::brute::NearestBothWays;
use crate::distance::squared_distance;
use crate::matcher::select;
use crate::matches::{Match, Nearest};
use crate::options::Options;

/// How many strips the second image is cut into.
const STRIPS: usize = 32;
/// How many cells a strip is cut into.
const CELLS: usize = 256;
/// Widens the runs by more than rounding can shift their ends; the exact test follows.
const SLACK_PX: f64 = 1e-3;

/// Where the partners of a keypoint may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EpipolarGuide {
    /// `F` of `x_bᵀ F x_a = 0`, row by row, in pixels; its scale does not matter.
    pub fundamental: [[f64; 3]; 3],
    /// Largest distance of a keypoint from its partner's epipolar line, in pixels, in both images.
    pub max_error_px: f64,
}

/// Matches two images whose epipolar geometry is known; ascending in `a`. `options.preempt` has no
/// effect.
pub fn match_guided(
    a: &Features,
    b: &Features,
    guide: &EpipolarGuide,
    options: &Options,
) -> Vec<Match> {
    let strips = [Strips::new(b, guide, 0), Strips::new(b, guide, 1)];
    let max_error_squared = guide.max_error_px * guide.max_error_px;
    let mut of_a = vec![Nearest::NONE; a.descriptors.len()];
    let mut of_b = vec![Nearest::NONE; b.descriptors.len()];
    for (i, (keypoint, descriptor)) in a.keypoints.iter().zip(&a.descriptors).enumerate() {
        let line = line_in_b(&guide.fundamental, keypoint);
        let normal_squared = line[0] * line[0] + line[1] * line[1];
        // Strips run across the axis along which the line advances faster.
        let axis = usize::from(line[0].abs() > line[1].abs());
        strips[axis].for_each_near(line, guide.max_error_px, |candidate| {
            let product = line[0] * candidate.x + line[1] * candidate.y + line[2];
            let allowed = max_error_squared * normal_squared.min(candidate.normal_squared);
            if allowed > 0.0 && product * product <= allowed {
                let j = candidate.index as usize;
                let distance = squared_distance(descriptor, &b.descriptors[j]);
                of_a[i].offer(candidate.index, distance);
                of_b[j].offer(i as u32, distance);
            }
        });
    }
    select(&NearestBothWays { of_a, of_b }, options)
}

/// A keypoint of the second image.
struct Candidate {
    x: f64,
    y: f64,
    index: u32,
    /// Squared length of the normal of its epipolar line in the first image.
    normal_squared: f64,
}

/// Keypoints sorted into strips along one axis and cells along the other.
struct Strips {
    /// 0: strips are columns of the image; 1: rows.
    axis: usize,
    strips: Steps<STRIPS>,
    cells: Steps<CELLS>,
    /// First candidate of every cell, strip by strip, and the end.
    starts: Vec<usize>,
    candidates: Vec<Candidate>,
}

/// An interval in `N` equal steps.
struct Steps<const N: usize> {
    origin: f64,
    width: f64,
}

impl<const N: usize> Steps<N> {
    fn over(values: impl Iterator<Item = f64>) -> Self {
        let (low, high) = values
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        Steps { origin: low, width: ((high - low) / N as f64).max(1.0) }
    }

    /// The step that holds `x`; the first or the last where `x` lies outside.
    fn step(&self, x: f64) -> usize {
        (((x - self.origin) / self.width) as usize).min(N - 1)
    }
}

impl Candidate {
    fn along(&self, axis: usize) -> f64 {
        [self.x, self.y][axis]
    }
}

impl Strips {
    fn new(b: &Features, guide: &EpipolarGuide, axis: usize) -> Self {
        let mut candidates: Vec<Candidate> = (b.keypoints.iter().zip(&b.descriptors).enumerate())
            .filter(|(_, (keypoint, _))| keypoint.x.is_finite() && keypoint.y.is_finite())
            .map(|(index, (keypoint, _))| Candidate {
                x: f64::from(keypoint.x),
                y: f64::from(keypoint.y),
                index: index as u32,
                normal_squared: normal_squared_in_a(&guide.fundamental, keypoint),
            })
            .collect();
        let strips = Steps::<STRIPS>::over(candidates.iter().map(|c| c.along(axis)));
        let cells = Steps::<CELLS>::over(candidates.iter().map(|c| c.along(1 - axis)));
        let place =
            |c: &Candidate| strips.step(c.along(axis)) * CELLS + cells.step(c.along(1 - axis));
        candidates.sort_by_key(place);
        let mut starts = vec![0; STRIPS * CELLS + 1];
        for candidate in &candidates {
            starts[place(candidate) + 1] += 1;
        }
        for place in 0..STRIPS * CELLS {
            starts[place + 1] += starts[place];
        }
        Strips { axis, strips, cells, starts, candidates }
    }

    /// Calls `visit` for all candidates within `max_error_px` of the line, and some more.
    fn for_each_near(&self, line: [f64; 3], max_error_px: f64, mut visit: impl FnMut(&Candidate)) {
        let (slope, offset) =
            (-line[self.axis] / line[1 - self.axis], -line[2] / line[1 - self.axis]);
        let margin = max_error_px * (1.0 + slope * slope).sqrt() + SLACK_PX;
        let end_of_cells = self.cells.origin + self.cells.width * CELLS as f64;
        for strip in 0..STRIPS {
            let start = self.strips.origin + self.strips.width * strip as f64;
            let (p, q) = (slope * start + offset, slope * (start + self.strips.width) + offset);
            let (low, high) = (p.min(q) - margin, p.max(q) + margin);
            if high < self.cells.origin || low > end_of_cells {
                continue;
            }
            let cells =
                strip * CELLS + self.cells.step(low)..strip * CELLS + self.cells.step(high) + 1;
            self.candidates[self.starts[cells.start]..self.starts[cells.end]]
                .iter()
                .for_each(&mut visit);
        }
    }
}

/// `F x_a`.
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
