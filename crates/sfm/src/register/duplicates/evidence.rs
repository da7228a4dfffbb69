//! Whether a division is one of two places, or of one place that changed.
//!
//! Each cell of an image with enough points that the other group lets expect is empty, shared or in
//! between, by the share of points that the other group alone observes.

use super::division::{MIN_POINTS, is_across, is_of_one_group, is_within};
use super::expected::Expectations;

/// Least share of points of the other group alone in an empty cell, and in one between.
const EMPTY: f64 = 5.0 / 6.0;
const BETWEEN: f64 = 0.5;
/// Two places have at least a third as many empty cells as images. An empty cell weighs at least
/// 5 ln 2 against one place, and the choice of a group for each image ln 2: were the cells
/// independent, a fifth would do. Several images miss the same for one reason. Drawn collections
/// (docs/benchmarks/photos.md) of two houses have 0.45 to 3.5. Half divides the same of them;
/// double leaves three of thirteen whole.
const MIN_EMPTY_PER_IMAGE: f64 = 1.0 / 3.0;
/// And they have this many times as many empty cells as cells between: two houses 2.1 to 27, one
/// place other than a recording of two cameras, also with half of its photos blurred, darkened and
/// noisy, 0.2 to 0.7 (1.4 if hardly anything is found). With half the same sets are divided; double
/// leaves one of two houses whole.
const MIN_EMPTY_PER_BETWEEN: f64 = 1.4;
/// And where they look alike, they find the points of the other one at least this many times as
/// often as their own: 0.86 to 2.3 times with two houses and in a street of equal houses, and 0.28
/// in the one place whose photos differ so much that hardly anything is found. In the tests of one
/// place of which only an object is found, and not as well as before, it is 0.79 at most. Half
/// divides that place, double leaves ten of thirteen models of two houses whole. A cell counts
/// where a point of the other group is found, which raises all these shares.
const MIN_RATE: f64 = 0.82;

/// Counts of a division.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Evidence {
    num_images: usize,
    /// Cells in which points of the other group are expected.
    num_empty: usize,
    num_between: usize,
    /// Expected and found points that only the other group lets expect, and only the own group, in
    /// cells where some of the former are found.
    of_other: [usize; 2],
    of_own: [usize; 2],
}

impl Evidence {
    pub(super) fn new(expectations: &Expectations, sides: &[bool]) -> Self {
        let Expectations { expected, cells, observers, images } = expectations;
        let mut this = Self { num_images: images.len(), ..Self::default() };
        let add = |to: &mut [usize; 2], counts: [usize; 2]| {
            (to[0], to[1]) = (to[0] + counts[0], to[1] + counts[1]);
        };
        for cell in cells {
            let (mut across, mut alone) = (0, 0);
            let (mut of_other, mut of_own) = ([0, 0], [0, 0]);
            for it in &expected[cell.clone()] {
                let count = |to: &mut [usize; 2]| {
                    (to[0], to[1]) = (to[0] + 1, to[1] + usize::from(it.is_found));
                };
                match (is_across(it, sides), is_within(it, sides)) {
                    (true, false) => count(&mut of_other),
                    (false, true) => count(&mut of_own),
                    _ => {}
                }
                if is_across(it, sides) {
                    let is_alone = !it.is_found && is_of_one_group(&observers[it.track], sides);
                    across += 1;
                    alone += usize::from(is_alone);
                }
            }
            if of_other[1] > 0 {
                add(&mut this.of_other, of_other);
                add(&mut this.of_own, of_own);
            }
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
            && self.of_other[1] >= MIN_POINTS
            && rate(self.of_other) >= MIN_RATE * rate(self.of_own)
    }

    /// Whether a better division may be one of two places: half of what that takes.
    pub(super) fn suggests_two_places(&self) -> bool {
        2.0 * self.num_empty as f64 >= MIN_EMPTY_PER_IMAGE * self.num_images as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_that_find_nothing_of_each_other_are_no_look_alike_places() {
        let two = Evidence {
            num_images: 60,
            num_empty: 60,
            num_between: 10,
            of_other: [1000, 600],
            of_own: [1000, 600],
        };
        assert!(two.is_of_two_places());
        let none = [0, 0];
        assert!(!Evidence { of_other: none, of_own: none, ..two }.is_of_two_places());
        assert!(!Evidence { of_other: [1000, 400], ..two }.is_of_two_places());
        assert!(!Evidence { num_between: 50, ..two }.is_of_two_places());
        assert!(!Evidence { num_empty: 15, ..two }.is_of_two_places());
    }
}
