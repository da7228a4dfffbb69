//! Whether a division is one of two places, or of one place that changed.
//!
//! Each cell of an image with enough points that the other group lets expect is empty, shared or in
//! between, by the share of points that the other group alone observes.

use super::division::{MIN_POINTS, is_across, is_of_one_group, is_within};
use super::expected::Expectations;

/// Least share of points of the other group alone in an empty cell, and in one between.
const EMPTY: f64 = 5.0 / 6.0;
const BETWEEN: f64 = 0.5;
/// Two places have at least half as many empty cells as images. An empty cell weighs at least
/// 5 ln 2 against one place, and the choice of a group for each image ln 2: were the cells
/// independent, a fifth would do. Several images miss the same for one reason. Two houses have 0.67
/// to 2.0, one place has up to 0.63 (of a table, which has not enough of the other two). With half
/// the same sets stay whole; with double also three of five sets of houses with photos between.
const MIN_EMPTY_PER_IMAGE: f64 = 0.5;
/// And they have this many times as many empty cells as cells between: two houses 1.8 to 20, one
/// place at most 1.0. The numbers are those of seeds 1 to 3, 11 and 12 of the collections in
/// docs/benchmarks/photos.md, which chose these three constants.
const MIN_EMPTY_PER_BETWEEN: f64 = 1.4;
/// And where they look alike, they find the points of the other one at least this many times as
/// often as their own: 0.98 to 1.23 times with two houses, 0.40 to 0.84 times with photos of one
/// place that differ.
const MIN_RATE: f64 = 0.9;

/// Counts of a division.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Evidence {
    num_images: usize,
    /// Cells in which points of the other group are expected.
    num_empty: usize,
    num_between: usize,
    /// Expected and found points in cells where some are found: of the other group, and of the own.
    across: [usize; 2],
    within: [usize; 2],
}

impl Evidence {
    pub(super) fn new(expectations: &Expectations, sides: &[bool]) -> Self {
        let Expectations { expected, cells, observers, images } = expectations;
        let mut this = Self { num_images: images.len(), ..Self::default() };
        let add = |to: &mut [usize; 2], num: usize, num_found: usize| {
            if num_found > 0 {
                (to[0], to[1]) = (to[0] + num, to[1] + num_found);
            }
        };
        for cell in cells {
            let (mut across, mut found, mut alone) = (0, 0, 0);
            let mut within = [0, 0];
            for it in &expected[cell.clone()] {
                if is_within(it, sides) {
                    within = [within[0] + 1, within[1] + usize::from(it.is_found)];
                }
                if is_across(it, sides) {
                    let is_alone = !it.is_found && is_of_one_group(&observers[it.track], sides);
                    across += 1;
                    found += usize::from(it.is_found);
                    alone += usize::from(is_alone);
                }
            }
            add(&mut this.across, across, found);
            add(&mut this.within, within[0], within[1]);
            if across >= MIN_POINTS {
                let share = alone as f64 / across as f64;
                this.num_empty += usize::from(share >= EMPTY);
                this.num_between += usize::from((BETWEEN..EMPTY).contains(&share));
            }
        }
        this
    }

    /// Whether the model holds two places.
    pub(super) fn is_of_two_places(&self) -> bool {
        let rate = |[num, found]: [usize; 2]| found as f64 / num.max(1) as f64;
        self.num_empty as f64 >= MIN_EMPTY_PER_IMAGE * self.num_images as f64
            && self.num_empty as f64 >= MIN_EMPTY_PER_BETWEEN * self.num_between as f64
            && rate(self.across) >= MIN_RATE * rate(self.within)
    }

    /// Whether a better division may be one of two places: half of what that takes.
    pub(super) fn suggests_two_places(&self) -> bool {
        2.0 * self.num_empty as f64 >= MIN_EMPTY_PER_IMAGE * self.num_images as f64
    }
}
