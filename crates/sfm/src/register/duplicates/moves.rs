//! Divisions that change by moves of images to the other group, and local search with them.

use rayon::prelude::*;

use super::division::{Counts, Points};

/// Passes until nothing grows, and rounds until the weights stay. They bound the time; not varied.
const MAX_PASSES: usize = 60;
const MAX_ROUNDS: usize = 8;
/// Images whose surroundings are tried, evenly among all. Bounds the time; not varied.
const MAX_CENTRES: usize = 64;
/// Images whose move is tried when a division is settled, those that seem to gain most, and sizes
/// of sets around one. Bounds the time of large models; the sets that were measured have fewer.
const MAX_SETTLING: usize = 128;
/// Smallest gain of a change, which rounding does not reach.
const MIN_GAIN: f64 = 1e-6;

/// A division, what moves gain, and the best division since the first one.
pub(super) struct Moves<'a> {
    points: &'a Points<'a>,
    weights: &'a [f64],
    sides: Vec<bool>,
    counts: Vec<Counts>,
    /// [`Points::gains`] of each point.
    gains: Vec<[[f64; 2]; 2]>,
    /// What the move of each image gains.
    totals: Vec<f64>,
    moved: Vec<usize>,
    sum: f64,
    /// The largest sum, and after how many moves.
    best: (f64, usize),
}

impl<'a> Moves<'a> {
    fn new(points: &'a Points, sides: &[bool], weights: &'a [f64]) -> Self {
        let counts = points.counts(sides);
        let gains: Vec<[[f64; 2]; 2]> = counts.iter().map(|it| points.gains(it)).collect();
        let total = |image: usize| -> f64 {
            let gain = |&(track, observes): &(usize, bool)| {
                let gains = gains[track][usize::from(observes)][usize::from(sides[image])];
                weights[track] * points.factor(image, observes) * gains
            };
            points.of_images[image].iter().map(gain).sum()
        };
        let totals = (0..sides.len()).map(total).collect();
        let (sides, moved) = (sides.to_vec(), Vec::new());
        Self { points, weights, sides, counts, gains, totals, moved, sum: 0.0, best: (MIN_GAIN, 0) }
    }

    /// Moves an image to the other group.
    fn move_image(&mut self, image: usize) {
        self.sum += self.totals[image];
        let from = usize::from(self.sides[image]);
        for &(track, observes) in &self.points.of_images[image] {
            self.counts[track].move_image(observes, from, self.points.factor(image, observes));
            let before = self.gains[track];
            let after = self.points.gains(&self.counts[track]);
            self.gains[track] = after;
            for &(other, observes) in &self.points.of_tracks[track] {
                let (kind, side) = (usize::from(observes), usize::from(self.sides[other]));
                // The image itself: below.
                self.totals[other] += self.weights[track]
                    * self.points.factor(other, observes)
                    * (after[kind][side] - before[kind][side]);
            }
        }
        self.sides[image] = !self.sides[image];
        let side = usize::from(self.sides[image]);
        let gain = |&(track, observes): &(usize, bool)| {
            let gains = self.gains[track][usize::from(observes)][side];
            self.weights[track] * self.points.factor(image, observes) * gains
        };
        self.totals[image] = self.points.of_images[image].iter().map(gain).sum();
        self.moved.push(image);
        if self.sum > self.best.0 {
            self.best = (self.sum, self.moved.len());
        }
    }

    /// Whether there is a better division than the first, which `sides` becomes.
    fn keep_best(self, sides: &mut [bool]) -> bool {
        self.moved[..self.best.1].iter().for_each(|image| sides[*image] = !sides[*image]);
        self.best.1 > 0
    }
}

/// How thorough a local search is.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub(super) enum Effort {
    /// Moves of single images that gain.
    Single,
    /// Also sequences of moves, of which some lose.
    Sequences,
    /// Also moves of all images around one.
    Surroundings,
}

/// A division near `sides` that the search does not improve. `has_weights`: `sides` tells the
/// weights of the points; else they are equal at first.
pub(super) fn local_best(
    points: &Points,
    mut sides: Vec<bool>,
    has_weights: bool,
    effort: Effort,
) -> Vec<bool> {
    if !has_weights {
        improve(points, &mut sides, &vec![1.0; points.of_tracks.len()], Effort::Single);
    }
    for _ in 0..MAX_ROUNDS {
        let before = sides.clone();
        let weights = points.weights(&sides);
        improve(points, &mut sides, &weights, effort);
        if sides == before {
            break;
        }
    }
    oriented(&sides)
}

fn improve(points: &Points, sides: &mut [bool], weights: &[f64], effort: Effort) {
    single(points, sides, weights);
    if effort >= Effort::Sequences {
        sequences(points, sides, weights);
    }
    if effort >= Effort::Surroundings {
        while surroundings(points, sides, weights) {
            sequences(points, sides, weights);
        }
    }
}

/// Moves single images as long as the sum grows.
fn single(points: &Points, sides: &mut [bool], weights: &[f64]) {
    let mut moves = Moves::new(points, sides, weights);
    for _ in 0..MAX_PASSES {
        let before = moves.moved.len();
        for image in 0..sides.len() {
            if moves.totals[image] > MIN_GAIN {
                moves.move_image(image);
            }
        }
        if moves.moved.len() == before {
            break;
        }
    }
    sides.copy_from_slice(&moves.sides);
}

/// Moves images one after the other, each the one that gains most or loses least among those that
/// were not moved yet, and keeps the best of these divisions (Fiduccia & Mattheyses 1982), as long
/// as the sum grows.
fn sequences(points: &Points, sides: &mut [bool], weights: &[f64]) {
    for _ in 0..MAX_PASSES {
        let mut moves = Moves::new(points, sides, weights);
        let mut open: Vec<usize> = (0..sides.len()).collect();
        // After all, the groups are exchanged.
        for _ in 0..sides.len() / 2 {
            let total = |at: &usize| moves.totals[open[*at]];
            let Some(at) = (0..open.len()).max_by(|a, b| total(a).total_cmp(&total(b))) else {
                break;
            };
            moves.move_image(open.remove(at));
        }
        if !moves.keep_best(sides) {
            break;
        }
    }
}

/// Moves the images around one, the nearest first, and keeps the best of these divisions, for each
/// of several. Where few photos connect two directions, the groups may be exchanged in one of them.
/// Returns whether the sum grew.
fn surroundings(points: &Points, sides: &mut [bool], weights: &[f64]) -> bool {
    let mut is_changed = false;
    for nearest in around(points, sides.len()) {
        let mut moves = Moves::new(points, sides, weights);
        nearest[..sides.len() / 2].iter().for_each(|image| moves.move_image(*image));
        is_changed |= moves.keep_best(sides);
    }
    is_changed
}

/// A division near `sides` that no move of one image improves, with the weights of the points after
/// the move, of at most [`MAX_SETTLING`] images in at most [`MAX_PASSES`] passes. Other moves keep
/// the weights, with which an image that joins its group seems to lose what its own cells say.
pub(super) fn settled(points: &Points, mut sides: Vec<bool>) -> Vec<bool> {
    let mut sum = points.sum(&sides);
    for _ in 0..MAX_PASSES {
        let gain = |image| (points.sum(&exchanged(&sides, &[image])) - sum, image);
        let images = likely_to_gain(points, &sides);
        let mut gains: Vec<(f64, usize)> = images.into_par_iter().map(gain).collect();
        gains.retain(|(gain, _)| *gain > MIN_GAIN);
        gains.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        if gains.is_empty() {
            break;
        }
        for (_, image) in gains {
            // One move changes what others gain.
            let next = exchanged(&sides, &[image]);
            let next_sum = points.sum(&next);
            if next_sum > sum + MIN_GAIN {
                (sides, sum) = (next, next_sum);
            }
        }
    }
    oriented(&sides)
}

/// The images whose move gains most or loses least with the weights before it, in order.
fn likely_to_gain(points: &Points, sides: &[bool]) -> Vec<usize> {
    let mut images: Vec<usize> = (0..sides.len()).collect();
    if images.len() > MAX_SETTLING {
        let weights = points.weights(sides);
        let totals = Moves::new(points, sides, &weights).totals;
        images.sort_by(|a, b| totals[*b].total_cmp(&totals[*a]).then(a.cmp(b)));
        images.truncate(MAX_SETTLING);
        images.sort_unstable();
    }
    images
}

/// [`settled`], also with moves of the images around one, the nearest ones.
pub(super) fn settled_around(points: &Points, mut sides: Vec<bool>) -> Vec<bool> {
    for _ in 0..MAX_ROUNDS {
        sides = settled(points, sides);
        let mut sum = points.sum(&sides);
        let before = sides.clone();
        for nearest in around(points, sides.len()) {
            let moved = |num: usize| (points.sum(&exchanged(&sides, &nearest[..num])), num);
            let sizes: Vec<usize> =
                (2..=sides.len() / 2).step_by(sides.len().div_ceil(2 * MAX_SETTLING)).collect();
            let sums: Vec<(f64, usize)> = sizes.into_par_iter().map(moved).collect();
            let best = sums.into_iter().max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
            if let Some((best, num)) = best.filter(|(best, _)| *best > sum + MIN_GAIN) {
                (sides, sum) = (exchanged(&sides, &nearest[..num]), best);
            }
        }
        if sides == before {
            break;
        }
    }
    sides
}

/// The division with some images in the other group.
fn exchanged(sides: &[bool], images: &[usize]) -> Vec<bool> {
    let mut exchanged = sides.to_vec();
    images.iter().for_each(|image| exchanged[*image] = !exchanged[*image]);
    exchanged
}

/// The same division, with the first image in the first group.
fn oriented(sides: &[bool]) -> Vec<bool> {
    let is_first = sides.first().copied().unwrap_or(false);
    sides.iter().map(|side| *side != is_first).collect()
}

/// The other images around each of several, the nearest first.
fn around<'a>(points: &'a Points, num_images: usize) -> impl Iterator<Item = &'a Vec<usize>> {
    points.nearest.iter().step_by(num_images.div_ceil(MAX_CENTRES).max(1))
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::Rng;
    use tiepoint_scene::ImageId;

    use super::*;
    use crate::register::duplicates::expected::{Expectations, Expected, MAX_WITNESSES};

    const IMAGES: usize = 12;
    const TRACKS: usize = 40;
    const MOVES: usize = 20;
    /// Of sums of some hundred terms.
    const TOLERANCE: f64 = 1e-9;

    /// Random observations and expectations.
    fn random(rng: &mut Rng) -> (Expectations, Vec<Vec<usize>>) {
        let images = (0..IMAGES as u32).map(ImageId).collect();
        let (mut observers, mut expected, mut cells) = (Vec::new(), Vec::new(), Vec::new());
        for track in 0..TRACKS {
            let of_track: Vec<usize> = (0..IMAGES).filter(|_| rng.uniform() < 0.4).collect();
            let begin = expected.len();
            for image in 0..IMAGES {
                let Some(witness) = of_track.iter().find(|it| **it != image) else { continue };
                let (witnesses, is_found) = ([*witness; MAX_WITNESSES], of_track.contains(&image));
                expected.push(Expected { image, track, is_found, witnesses });
            }
            cells.push(begin..expected.len());
            observers.push(of_track);
        }
        let nearest = (0..IMAGES).map(|k| (0..IMAGES).map(|i| (i + k) % IMAGES).collect());
        (Expectations { images, observers, expected, cells }, nearest.collect())
    }

    const DRAWS: u64 = 32;

    /// The slow twin: the sum of each division.
    #[test]
    fn what_moves_gain_is_the_difference_of_the_sums() {
        for seed in 0..DRAWS {
            let mut rng = Rng::stream(seed, &[]);
            let (expectations, nearest) = random(&mut rng);
            let points = Points::new(&expectations, &nearest).expect("many points are found");
            let mut sides: Vec<bool> = (0..IMAGES).map(|_| rng.below(2) == 1).collect();
            let weights: Vec<f64> = (0..TRACKS).map(|_| rng.uniform()).collect();
            let first = points.weighted_sum(&sides, &weights);
            let mut moves = Moves::new(&points, &sides, &weights);
            for _ in 0..MOVES {
                let before = points.weighted_sum(&sides, &weights);
                for image in 0..IMAGES {
                    let mut moved = sides.clone();
                    moved[image] = !moved[image];
                    let gain = points.weighted_sum(&moved, &weights) - before;
                    assert!((moves.totals[image] - gain).abs() < TOLERANCE, "seed {seed}");
                }
                assert!((moves.sum - (before - first)).abs() < TOLERANCE, "seed {seed}");
                let image = rng.below(IMAGES);
                moves.move_image(image);
                sides[image] = !sides[image];
            }
        }
    }

    /// Where the search with constant weights ends, single moves may still gain.
    #[test]
    fn no_move_of_one_image_improves_a_settled_division() {
        let mut num_improved = 0;
        for seed in 0..DRAWS {
            let mut rng = Rng::stream(seed, &[]);
            let (expectations, nearest) = random(&mut rng);
            let points = Points::new(&expectations, &nearest).expect("many points are found");
            let first: Vec<bool> = (0..IMAGES).map(|_| rng.below(2) == 1).collect();
            let is_improved = |sides: &[bool]| {
                let sum = points.sum(sides) + 2.0 * MIN_GAIN;
                (0..IMAGES).any(|image| points.sum(&exchanged(sides, &[image])) > sum)
            };
            let searched = local_best(&points, first, true, Effort::Surroundings);
            num_improved += usize::from(is_improved(&searched));
            let mut sum = points.sum(&searched);
            for settled in [settled(&points, searched.clone()), settled_around(&points, searched)] {
                assert!(!is_improved(&settled), "seed {seed}");
                assert!(points.sum(&settled) > sum - TOLERANCE, "seed {seed}");
                sum = points.sum(&settled);
            }
        }
        assert!(num_improved > 0);
    }

    /// With the same weights.
    #[test]
    fn more_effort_finds_no_worse_division() {
        for seed in 0..DRAWS {
            let mut rng = Rng::stream(seed, &[]);
            let (expectations, nearest) = random(&mut rng);
            let points = Points::new(&expectations, &nearest).expect("many points are found");
            let first: Vec<bool> = (0..IMAGES).map(|_| rng.below(2) == 1).collect();
            let weights: Vec<f64> = (0..TRACKS).map(|_| rng.uniform()).collect();
            let mut last = points.weighted_sum(&first, &weights);
            for effort in [Effort::Single, Effort::Sequences, Effort::Surroundings] {
                let mut sides = first.clone();
                improve(&points, &mut sides, &weights, effort);
                let sum = points.weighted_sum(&sides, &weights);
                assert!(sum > last - TOLERANCE, "seed {seed}, {effort:?}");
                last = sum;
            }
        }
    }
}
