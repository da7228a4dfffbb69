//! A division of the images into two groups, and what speaks for it.
//!
//! A point whose observers are all in one group counts for a division by each image of the other
//! group that is expected to observe it and does not; a point that a single image of a group
//! observes, beside at least two of the other group, counts against it. With the probability r of
//! finding a point in one place, and q of finding it in the other one, the logarithms of the
//! likelihood ratios are ln((1 − q) / (1 − r)) and ln(r / q). For a miss, r is that of the image:
//! some find little anywhere. What both groups observe is the part that looks alike in both places,
//! and counts nothing.
//!
//! Verified pairs that contradict the poses count nothing: they match different sides of what looks
//! alike, of one place or of both.
//!
//! A point weighs as much as its surroundings, the cells of images it is expected in, are of one
//! group alone: beside what looks alike, single points tell little.

use super::expected::{Expectations, Expected};

/// The probability q that a point is found by an image of another place: wrong matches that agree
/// with the poses. Of pairs of photos of two identical houses, on twins-apart, seed 11
/// (docs/benchmarks/photos.md).
pub(super) const FOUND_ELSEWHERE: f64 = 0.12;
/// Points of a cell that tells something.
pub(super) const MIN_POINTS: usize = 5;
/// Weight of a point that no image of the other group is expected to observe.
const UNKNOWN_WEIGHT: f64 = 0.5;
/// The share of its expected points that an image finds counts as if this many further ones were
/// found as often as in the whole model. With half and double, four drawn models are divided with
/// at most two photos in another group.
const PRIOR_POINTS: f64 = 50.0;

/// What is known of the points for divisions.
pub(super) struct Points<'a> {
    pub(super) expectations: &'a Expectations,
    /// For each image the points that it observes or is expected to observe and misses.
    pub(super) of_images: Vec<Vec<(usize, bool)>>,
    /// For each point the images that observe it, or are expected to and miss it.
    pub(super) of_tracks: Vec<Vec<(usize, bool)>>,
    /// For each image all images, the nearest first.
    pub(super) nearest: &'a [Vec<usize>],
    /// For each image what a point that it misses counts.
    ln_missed: Vec<f64>,
    ln_found: f64,
}

/// By group, the number of observers of a point, and the sum over the images that miss it of what
/// a miss of each counts.
#[derive(Clone, Copy, Default)]
pub(super) struct Counts {
    observers: [u32; 2],
    missing: [f64; 2],
}

impl<'a> Points<'a> {
    /// `None` if points are found so rarely that a miss tells nothing.
    pub(super) fn new(expectations: &'a Expectations, nearest: &'a [Vec<usize>]) -> Option<Self> {
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
        let ln_found = (found / FOUND_ELSEWHERE).ln();
        let ln_missed = ln_missed(expectations, found);
        Some(Self { expectations, of_images, of_tracks, nearest, ln_missed, ln_found })
    }

    /// What a point says about a division.
    fn evidence(&self, counts: &Counts) -> f64 {
        let [first, second] = counts.observers;
        match counts.side_that_misses() {
            Some(side) => counts.missing[side],
            None if first.min(second) == 1 && first.max(second) > 1 => -self.ln_found,
            None => 0.0,
        }
    }

    /// The factor of [`Self::gains`] for an image: 1 if it observes the point, and else what a miss
    /// of it counts.
    pub(super) fn factor(&self, image: usize, observes: bool) -> f64 {
        if observes { 1.0 } else { self.ln_missed[image] }
    }

    pub(super) fn counts(&self, sides: &[bool]) -> Vec<Counts> {
        let mut counts = vec![Counts::default(); self.expectations.observers.len()];
        for (image, points) in self.of_images.iter().enumerate() {
            for &(track, observes) in points {
                counts[track].add(
                    observes,
                    usize::from(sides[image]),
                    self.factor(image, observes),
                );
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

    /// What the move of an image changes in the evidence of a point, but for the
    /// [factor](Self::factor) of the image: of one that misses the point and one that observes it,
    /// from either group.
    pub(super) fn gains(&self, counts: &Counts) -> [[f64; 2]; 2] {
        let before = self.evidence(counts);
        let missing = [0, 1].map(|from| match counts.side_that_misses() {
            Some(side) if side == from => -1.0,
            Some(_) => 1.0,
            None => 0.0,
        });
        let observing = [0, 1].map(|from| {
            let mut moved = *counts;
            if moved.observers[from] == 0 {
                return 0.0;
            }
            moved.move_image(true, from, 1.0);
            self.evidence(&moved) - before
        });
        [missing, observing]
    }

    /// The sum of a division.
    pub(super) fn sum(&self, sides: &[bool]) -> f64 {
        self.weighted_sum(sides, &self.weights(sides))
    }

    pub(super) fn weighted_sum(&self, sides: &[bool], weights: &[f64]) -> f64 {
        let weighted = weights.iter().zip(self.counts(sides));
        weighted.map(|(weight, counts)| weight * self.evidence(&counts)).sum()
    }
}

impl Counts {
    /// The group whose misses speak for a division: the other one has all observers.
    fn side_that_misses(&self) -> Option<usize> {
        let [first, second] = self.observers;
        (first.min(second) == 0).then_some(usize::from(second == 0))
    }

    fn add(&mut self, observes: bool, side: usize, factor: f64) {
        if observes {
            self.observers[side] += 1;
        } else {
            self.missing[side] += factor;
        }
    }

    /// Moves an image that observes the point, or misses it, to the other group.
    pub(super) fn move_image(&mut self, observes: bool, from: usize, factor: f64) {
        self.add(observes, 1 - from, factor);
        if observes {
            self.observers[from] -= 1;
        } else {
            self.missing[from] -= factor;
        }
    }
}

/// ln((1 − q) / (1 − r)) for each image, at least 0, with the share r of its expected points that
/// it finds; `found` is that of all images.
fn ln_missed(expectations: &Expectations, found: f64) -> Vec<f64> {
    let mut counts = vec![(PRIOR_POINTS, PRIOR_POINTS * found); expectations.images.len()];
    for it in &expectations.expected {
        let (num, num_found) = &mut counts[it.image];
        (*num, *num_found) = (*num + 1.0, *num_found + f64::from(u8::from(it.is_found)));
    }
    let of = |(num, num_found): (f64, f64)| {
        let missed = (1.0 - num_found / num).max(f64::EPSILON);
        ((1.0 - FOUND_ELSEWHERE) / missed).ln().max(0.0)
    };
    counts.into_iter().map(of).collect()
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

#[cfg(test)]
mod tests {
    use tiepoint_scene::ImageId;

    use super::*;
    use crate::register::duplicates::expected::MAX_WITNESSES;

    const EXPECTED: usize = 1000;
    /// Of a few roundings.
    const TOLERANCE: f64 = 1e-12;

    /// Of [`EXPECTED`] points an image finds `found`.
    fn of_images(found: &[usize]) -> Vec<f64> {
        let images = (0..found.len() as u32).map(ImageId).collect();
        let of_image = |(image, found): (usize, &usize)| {
            let found = *found;
            (0..EXPECTED).map(move |track| Expected {
                image,
                track,
                is_found: track < found,
                witnesses: [image; MAX_WITNESSES],
            })
        };
        let expected = found.iter().enumerate().flat_map(of_image).collect();
        let expectations = Expectations { images, observers: Vec::new(), expected, cells: vec![] };
        let rate = expectations.rate().expect("points are expected");
        ln_missed(&expectations, rate)
    }

    #[test]
    fn a_miss_of_an_image_that_finds_little_counts_little() {
        let [none, few, most] = of_images(&[0, 300, 800])[..] else { unreachable!() };
        // The share of an image counts, drawn to that of all by 50 points.
        let of = |found: f64| {
            let missed = 1.0 - (found + PRIOR_POINTS * 1100.0 / 3000.0) / (1000.0 + PRIOR_POINTS);
            ((1.0 - FOUND_ELSEWHERE) / missed).ln()
        };
        assert_eq!(none, 0.0);
        for (counts, found) in [(few, 300.0), (most, 800.0)] {
            assert!((counts - of(found)).abs() < TOLERANCE, "{counts}");
        }
    }
}
