//! What connects two places that look alike, and whether two models that it joined are of one
//! place: their images find each other's points.
//!
//! A wrong connection matches other sides of what looks alike. The images of both models then look
//! at the same parts of it and find many points there, and miss everything beside it.

use std::collections::BTreeSet;

use rayon::prelude::*;
use tiepoint_scene::{CorrespondenceGraph, ImageId, ImagePair, Reconstruction};

use super::division::{FOUND_ELSEWHERE, MIN_POINTS, is_across, is_within};
use super::expected::{Expectations, Expected};
use crate::register::significance::ln_binomial_false_alarms;
use crate::two_view::agreement;

/// A cell with fewer found points than this share of those that are expected is poor. In one place
/// half and more are found (0.52 to 0.77 of drawn collections), and of five expected points at most
/// one with a probability of 0.19 or less.
const POOR: f64 = 1.0 / 3.0;
/// Poor cells are too many between the groups if their share is this many times as large as within
/// them, and chance explains that with this probability at most. Three wrong connections of drawn
/// collections (docs/benchmarks/photos.md) have 3.2 to 7 times the share, with 0.003 and less, a
/// right one 0.4 times. Half and double of the level decide the same, and half of the ratio.
const MAX_POOR_RATIO: f64 = 2.0;
const LEVEL: f64 = 0.01;

/// The verified pairs between the images of a group and the other ones of which most matches
/// disagree with the poses by more than `max_error_px`: one model of both places contradicts them.
pub(super) fn connections(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    group: &BTreeSet<ImageId>,
    max_error_px: f64,
) -> BTreeSet<ImagePair> {
    let is_contradicted = |pair: &ImagePair| {
        let pose = |image| model.image(image).cam_from_world();
        let (Some(a), Some(b)) = (pose(pair.a), pose(pair.b)) else { return false };
        let agrees = agreement(graph, model, *pair, [a, b], max_error_px);
        2 * agrees.num_agreeing < agrees.num_matches
    };
    let is_across = |pair: &&ImagePair| group.contains(&pair.a) != group.contains(&pair.b);
    let across: Vec<ImagePair> = graph.pairs().keys().filter(is_across).copied().collect();
    across.into_par_iter().filter(is_contradicted).collect()
}

/// Whether the images of a group and the other ones, where they look at the same, find the points
/// of the others as one place lets expect rather than two: more often than the geometric mean of
/// the two shares, and with no more poor cells than within the groups.
pub(crate) fn find_each_other(
    graph: &CorrespondenceGraph,
    model: &Reconstruction,
    group: &BTreeSet<ImageId>,
) -> bool {
    let expectations = Expectations::new(graph, model);
    let sides: Vec<bool> = expectations.images.iter().map(|id| group.contains(id)).collect();
    let [across, within] =
        [is_across, is_within].map(|is_of| Found::new(&expectations, |it| is_of(it, &sides)));
    across.rate() >= (FOUND_ELSEWHERE * within.rate()).sqrt() && !across.is_poorer_than(&within)
}

/// Expected points and those that are found, and cells with enough expected points and those of
/// them in which few are found.
#[derive(Default)]
struct Found {
    num: usize,
    num_found: usize,
    num_cells: usize,
    num_poor: usize,
}

impl Found {
    fn new(expectations: &Expectations, is_of: impl Fn(&Expected) -> bool) -> Self {
        let mut this = Self::default();
        for cell in &expectations.cells {
            let of_cell = || expectations.expected[cell.clone()].iter().filter(|it| is_of(it));
            let (num, num_found) = (of_cell().count(), of_cell().filter(|it| it.is_found).count());
            (this.num, this.num_found) = (this.num + num, this.num_found + num_found);
            if num >= MIN_POINTS {
                this.num_cells += 1;
                this.num_poor += usize::from((num_found as f64) < POOR * num as f64);
            }
        }
        this
    }

    /// The share of the points that are found.
    fn rate(&self) -> f64 {
        self.num_found as f64 / self.num.max(1) as f64
    }

    /// Whether there are too many poor cells, beside those of another count.
    fn is_poorer_than(&self, other: &Self) -> bool {
        // Neither 0 nor 1 (Laplace's rule).
        let usual = (other.num_poor + 1) as f64 / (other.num_cells + 2) as f64;
        self.num_poor as f64 > MAX_POOR_RATIO * usual * self.num_cells as f64
            && ln_binomial_false_alarms(1, self.num_cells, self.num_poor, usual) <= LEVEL.ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(num_poor: usize, num_cells: usize) -> Found {
        Found { num_poor, num_cells, ..Found::default() }
    }

    /// The counts of drawn collections.
    #[test]
    fn wrong_connections_have_many_poor_cells() {
        for (across, within) in [([17, 32], [77, 466]), ([17, 42], [35, 321]), ([4, 12], [6, 137])]
        {
            assert!(cells(across[0], across[1]).is_poorer_than(&cells(within[0], within[1])));
        }
        assert!(!cells(2, 24).is_poorer_than(&cells(59, 277)));
        // Somewhat worse, of many cells; and hardly any cell.
        assert!(!cells(600, 2000).is_poorer_than(&cells(200, 1000)));
        assert!(!cells(1, 1).is_poorer_than(&cells(100, 1000)));
        assert!(!cells(0, 0).is_poorer_than(&cells(0, 0)));
    }
}
