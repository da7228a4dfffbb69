//! A division of the images into two groups, and what speaks for it.
//!
//! A point whose observers are all in one group counts for a division by each image of the other
//! group that is expected to observe it and does not; a point that a single image of a group
//! observes, beside at least two of the other group, counts against it. With the probability r of
//! finding a point in one place, and q of finding it in the other one, the logarithms of the
//! likelihood ratios are ln((1 − q) / (1 − r)) and ln(r / q). What both groups observe is the part
//! that looks alike in both places, and counts nothing.
//!
//! A verified pair that contradicts the poses counts against a division that puts both images into
//! one group: there, its poses would be right.
//!
//! A point weighs as much as its surroundings, the cells of images it is expected in, are of one
//! group alone: beside what looks alike, single points tell little.

use super::expected::{Expectations, Expected};
use super::relations::Relations;

/// The probability q that a point is found by an image of another place: wrong matches that agree
/// with the poses. Of pairs of photos of two identical houses, on twins-apart, seed 11
/// (docs/benchmarks/photos.md).
pub(super) const FOUND_ELSEWHERE: f64 = 0.12;
/// Points of a cell that tells something.
pub(super) const MIN_POINTS: usize = 5;
/// Weight of a point that no image of the other group is expected to observe.
const UNKNOWN_WEIGHT: f64 = 0.5;

/// What is known of the points for divisions.
pub(super) struct Points<'a> {
    pub(super) expectations: &'a Expectations,
    /// For each image the points that it observes or is expected to observe and misses.
    pub(super) of_images: Vec<Vec<(usize, bool)>>,
    /// For each point the images that observe it, or are expected to and miss it.
    pub(super) of_tracks: Vec<Vec<(usize, bool)>>,
    pub(super) relations: &'a Relations,
    /// For each image those of the verified pairs that contradict the poses.
    pub(super) contradicting: Vec<Vec<usize>>,
    ln_missed: f64,
    ln_found: f64,
}

/// Observers and missing images of a point by group.
#[derive(Clone, Copy, Default)]
pub(super) struct Counts {
    observers: [u32; 2],
    missing: [u32; 2],
}

impl<'a> Points<'a> {
    /// `None` if points are found so rarely that a miss tells nothing.
    pub(super) fn new(expectations: &'a Expectations, relations: &'a Relations) -> Option<Self> {
        let found = expectations.rate().filter(|rate| *rate > FOUND_ELSEWHERE)?;
        let mut of_images = vec![Vec::new(); expectations.images.len()];
        for (track, observers) in expectations.observers.iter().enumerate() {
            observers.iter().for_each(|image| of_images[*image].push((track, true)));
        }
        for it in expectations.expected.iter().filter(|it| !it.is_found) {
            of_images[it.image].push((it.track, false));
        }
        let mut of_tracks = vec![Vec::new(); expectations.observers.len()];
        for (image, points) in of_images.iter().enumerate() {
            points.iter().for_each(|(track, observes)| of_tracks[*track].push((image, *observes)));
        }
        let mut contradicting = vec![Vec::new(); of_images.len()];
        for &(one, other) in &relations.contradictions {
            contradicting[one].push(other);
            contradicting[other].push(one);
        }
        let ln_missed = ((1.0 - FOUND_ELSEWHERE) / (1.0 - found).max(f64::EPSILON)).ln();
        let ln_found = (found / FOUND_ELSEWHERE).ln();
        Some(Self {
            expectations,
            of_images,
            of_tracks,
            relations,
            contradicting,
            ln_missed,
            ln_found,
        })
    }

    /// What a point says about a division.
    fn evidence(&self, counts: &Counts) -> f64 {
        let [first, second] = counts.observers;
        match first.min(second) {
            0 => self.ln_missed * f64::from(counts.missing[usize::from(second == 0)]),
            1 if first.max(second) > 1 => -self.ln_found,
            _ => 0.0,
        }
    }

    /// What a verified pair that contradicts the poses says against one group for both images: as
    /// much as the fewest points of a cell that tells something. Not varied.
    pub(super) fn weight_of_pair(&self) -> f64 {
        MIN_POINTS as f64 * self.ln_found
    }

    pub(super) fn counts(&self, sides: &[bool]) -> Vec<Counts> {
        let mut counts = vec![Counts::default(); self.expectations.observers.len()];
        for (image, points) in self.of_images.iter().enumerate() {
            for &(track, observes) in points {
                counts[track].of(observes)[usize::from(sides[image])] += 1;
            }
        }
        counts
    }

    /// The weight of each point: the mean, over the cells in which it is expected across the
    /// groups, of the share of the expectations there that one group alone observes.
    pub(super) fn weights(&self, sides: &[bool]) -> Vec<f64> {
        let Expectations { expected, cells, observers, .. } = self.expectations;
        let is_of_one: Vec<bool> =
            observers.iter().map(|images| is_of_one_group(images, sides)).collect();
        let mut sums = vec![(0.0, 0u32); observers.len()];
        for cell in cells {
            let across = || expected[cell.clone()].iter().filter(|it| is_across(it, sides));
            let num = across().count();
            let num_missed = across().filter(|it| is_of_one[it.track] && !it.is_found).count();
            for it in across() {
                let (sum, count) = &mut sums[it.track];
                (*sum, *count) = (*sum + num_missed as f64 / num as f64, *count + 1);
            }
        }
        let mean = |(sum, count): (f64, u32)| match count {
            0 => UNKNOWN_WEIGHT,
            _ => sum / f64::from(count),
        };
        sums.into_iter().map(mean).collect()
    }

    /// What the move of an image changes in the evidence of a point: of one that misses the point
    /// and one that observes it, from either group.
    pub(super) fn gains(&self, counts: &Counts) -> [[f64; 2]; 2] {
        let before = self.evidence(counts);
        [false, true].map(|observes| {
            [0, 1].map(|from| {
                let mut moved = *counts;
                if moved.of(observes)[from] == 0 {
                    return 0.0;
                }
                moved.move_image(observes, from);
                self.evidence(&moved) - before
            })
        })
    }

    /// The sum of a division.
    pub(super) fn sum(&self, sides: &[bool]) -> f64 {
        self.weighted_sum(sides, &self.weights(sides))
    }

    pub(super) fn weighted_sum(&self, sides: &[bool], weights: &[f64]) -> f64 {
        let weighted = weights.iter().zip(self.counts(sides));
        let of_points: f64 = weighted.map(|(weight, counts)| weight * self.evidence(&counts)).sum();
        let pairs = self.relations.contradictions.iter();
        let num_together = pairs.filter(|(one, other)| sides[*one] == sides[*other]).count();
        of_points - num_together as f64 * self.weight_of_pair()
    }
}

impl Counts {
    fn of(&mut self, observes: bool) -> &mut [u32; 2] {
        if observes { &mut self.observers } else { &mut self.missing }
    }

    /// Moves an image that observes the point, or misses it, to the other group.
    pub(super) fn move_image(&mut self, observes: bool, from: usize) {
        let of = self.of(observes);
        (of[from], of[1 - from]) = (of[from] - 1, of[1 - from] + 1);
    }
}

/// Whether all images are in one group.
pub(super) fn is_of_one_group(images: &[usize], sides: &[bool]) -> bool {
    images.windows(2).all(|pair| sides[pair[0]] == sides[pair[1]])
}

/// Whether an image of the other group lets expect the point.
pub(super) fn is_across(expected: &Expected, sides: &[bool]) -> bool {
    expected.witnesses.iter().any(|witness| sides[*witness] != sides[expected.image])
}

/// Whether an image of the same group lets expect the point.
pub(super) fn is_within(expected: &Expected, sides: &[bool]) -> bool {
    expected.witnesses.iter().any(|witness| sides[*witness] == sides[expected.image])
}
