//! Exact mutual matching with pruning by compressed descriptors.
//!
//! A sweep compares the compressed descriptors of all rows and columns ([`crate::compressed`]) and
//! computes the distance of descriptors at once where its lower bound is not above the limit of the
//! row. The limit is the largest distance that can still change the decision about the row
//! ([`Acceptance::limit`]). Where the nearest descriptor so far fails the ratio test, that is one
//! that would pass with it as second: 0.65 of its squared distance for a ratio of 0.8.
//!
//! A row that passes at the end has its nearest descriptor, but it may have skipped a second one
//! while it failed. If its limit was ever below the last one, the row is swept again with that.
//! The columns of the rows that pass are swept for the cross check. The matches are exactly those
//! of brute force.
//!
//! Measured on real photos, 20 to 40 distances are computed for a row, 3 % of the rows are swept
//! again, and 20 to 50 % of the columns are.

use crate::accept::Acceptance;
use crate::brute::Isa;
use crate::compressed::COMPRESSED_GROUPS;
use crate::matches::{Match, Nearest};
use crate::options::Options;
use crate::packed::{Packed, Vectors};
use crate::prepared::Prepared;

/// Time that a row takes with pruning besides the sweep, in nanoseconds; if brute force takes less,
/// descriptors are compared in full. Both take as long for 2000 columns with AVX-512 VNNI, for 1000
/// with AVX-VNNI and for 450 with AVX2. It changes no match. Half of it costs a third of the time
/// at 1000 columns with AVX-512; twice as much was not timed.
const ROW_NS: f64 = 540.0;
/// Time of a distance with all that it causes, in nanoseconds. Descriptors are compared in full if
/// the distances would take longer than brute force. It changes no match. Half and double were not
/// timed; no measured pair comes near the limit.
const DISTANCE_NS: f64 = 30.0;

/// The mutual matches of two images in ascending order of `a`; `None` if pruning does not pay.
pub(crate) fn match_pruned(
    isa: Isa,
    a: &Prepared,
    b: &Prepared,
    options: &Options,
) -> Option<Vec<Match>> {
    let acceptance = Acceptance::new(options);
    let full_row_ns = isa.pair_ns() * b.len() as f64;
    if full_row_ns < ROW_NS || !acceptance.has_limits() {
        return None;
    }
    let max_distances = full_row_ns * a.len() as f64 / DISTANCE_NS;
    match_with_limits(isa, a, b, &acceptance, max_distances as usize)
}

/// The mutual matches; `None` if more than `max_distances` would be computed.
fn match_with_limits(
    isa: Isa,
    a: &Prepared,
    b: &Prepared,
    acceptance: &Acceptance,
    max_distances: usize,
) -> Option<Vec<Match>> {
    let mut sweeps = Sweeps { isa, distances_left: max_distances };
    // The nearest neighbours among the computed distances.
    let mut of_a = vec![Nearest::NONE; a.len()];
    let mut of_b = vec![Nearest::NONE; b.len()];

    let mut rows: Vec<u32> = (0..a.len() as u32).collect();
    let mut limits = vec![acceptance.max_distance(); rows.len()];
    let mut least_limits = limits.clone();
    sweeps.run([a, b], &rows, &mut limits, |row, column, distance, limit| {
        of_b[column as usize].update(row, distance);
        let nearest = &mut of_a[row as usize];
        if distance < nearest.distance || f64::from(distance) <= *limit {
            nearest.update(column, distance);
            *limit = acceptance.limit(nearest);
            let least = &mut least_limits[row as usize];
            *least = least.min(*limit);
        }
    })?;
    rows.retain(|&row| is_mutual(row, &of_a, &of_b, acceptance));

    let mut again = rows.clone();
    again.retain(|&row| limits[row as usize] > least_limits[row as usize]);
    let mut limits: Vec<f64> = again.iter().map(|&row| limits[row as usize]).collect();
    sweeps.run([a, b], &again, &mut limits, |row, column, distance, limit| {
        let nearest = &mut of_a[row as usize];
        nearest.update(column, distance);
        if !acceptance.accepts(nearest) {
            *limit = -1.0;
        }
    })?;
    rows.retain(|&row| acceptance.accepts(&of_a[row as usize]));

    let columns: Vec<u32> = rows.iter().map(|&row| of_a[row as usize].index).collect();
    // Of equally near rows the first is the nearest.
    let limit = |nearest: &Nearest| acceptance.limit(nearest).max(nearest.distance.into());
    let mut limits: Vec<f64> = columns.iter().map(|&at| limit(&of_b[at as usize])).collect();
    sweeps.run([b, a], &columns, &mut limits, |column, row, distance, limit| {
        let nearest = &mut of_b[column as usize];
        let index = nearest.index;
        nearest.update(row, distance);
        if nearest.index != index || !acceptance.accepts(nearest) {
            *limit = -1.0;
        }
    })?;
    rows.retain(|&row| is_mutual(row, &of_a, &of_b, acceptance));

    let found = |a: u32| {
        let Nearest { index: b, distance, .. } = of_a[a as usize];
        Match { a, b, distance: distance.into() }
    };
    Some(rows.into_iter().map(found).collect())
}

/// Whether a row and its nearest column are each other's nearest and pass the tests, by the
/// distances that were computed.
fn is_mutual(row: u32, of_a: &[Nearest], of_b: &[Nearest], acceptance: &Acceptance) -> bool {
    let nearest = &of_a[row as usize];
    let is_back = |back: &Nearest| back.index == row && acceptance.accepts(back);
    acceptance.accepts(nearest) && is_back(&of_b[nearest.index as usize])
}

/// The sweeps of a pair of images.
struct Sweeps {
    isa: Isa,
    /// Number of distances that may still be computed.
    distances_left: usize,
}

impl Sweeps {
    /// Calls `on_distance` with row, column and distance, for the columns of `b` whose distance to
    /// a row of `a` may be within the limit of the row, and for some others; for some more than
    /// once. It may change the limit. `limits` are those of `rows`. `None` if too many distances
    /// are computed.
    fn run(
        &mut self,
        [a, b]: [&Prepared; 2],
        rows: &[u32],
        limits: &mut [f64],
        mut on_distance: impl FnMut(u32, u32, u32, &mut f64),
    ) -> Option<()> {
        let scores = a.compressed.scores(&b.compressed);
        let mut least: Vec<i32> =
            rows.iter().zip(&*limits).map(|(&row, &limit)| scores.least(row, limit)).collect();
        let some = Rows { all: &a.compressed.packed, rows };
        self.isa.for_each_candidate(&some, &b.compressed.packed, &mut least, |k, column, least| {
            self.distances_left = self.distances_left.checked_sub(1)?;
            let row = rows[k];
            let (from, to) = (&a.descriptors[row as usize], &b.descriptors[column as usize]);
            let distance = self.isa.squared_distance(from, to);
            let limit = limits[k];
            on_distance(row, column, distance, &mut limits[k]);
            if limits[k] != limit {
                *least = scores.least(row, limits[k]);
            }
            Some(())
        })
    }
}

/// Some rows of compressed descriptors.
struct Rows<'a> {
    all: &'a Packed<COMPRESSED_GROUPS>,
    rows: &'a [u32],
}

impl Vectors<COMPRESSED_GROUPS> for Rows<'_> {
    fn len(&self) -> usize {
        self.rows.len()
    }
    #[inline]
    fn word(&self, index: usize, group: usize) -> u32 {
        self.all.word(self.rows[index] as usize, group)
    }
}

#[cfg(test)]
mod tests;
