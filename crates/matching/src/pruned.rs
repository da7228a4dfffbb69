//! Exact mutual matching with pruning by compressed descriptors.
//!
//! All pairs of compressed descriptors ([`crate::compressed`]) are compared, which gives lower
//! bounds of the distances. Exact distances are then computed in ascending order of the bounds,
//! until the bounds decide the ratio test of the row: it fails for any distances of the other
//! descriptors, or it passes for any. The undecided rows and columns are compared in full. The
//! matches are exactly those of brute force.

use crate::accept::Acceptance;
use crate::brute::{Isa, RowLanes, compare};
use crate::compressed::DistanceBound;
use crate::matches::{Match, Nearest};
use crate::options::Options;
use crate::prepared::Prepared;

/// Smaller numbers of descriptor pairs are compared in full without pruning.
const MIN_PAIRS: usize = 500 * 500;
/// All descriptors are compared in full if the ratio of undecided rows exceeds this.
const MAX_UNDECIDED_RATIO: f64 = 0.3;

/// The decision about a row.
enum RowDecision {
    /// No descriptor passes the tests.
    Rejected,
    /// Index and squared distance of the nearest descriptor, which passes the tests.
    Accepted(u32, u32),
    /// The decision needs all distances.
    Undecided,
}

/// The mutual matches of two images in ascending order of `a`; `None` if pruning does not pay.
pub(crate) fn match_pruned(
    isa: Isa,
    a: &Prepared,
    b: &Prepared,
    options: &Options,
) -> Option<Vec<Match>> {
    if a.len() * b.len() < MIN_PAIRS {
        return None;
    }
    let acceptance = Acceptance::new(options);
    let bound = a.compressed.bound(&b.compressed);
    let mut decisions = Vec::with_capacity(a.len());
    // For each column, the nearest neighbours among the computed exact distances.
    let mut column_neighbours = vec![Nearest::NONE; b.len()];
    let column_bounds = compare(isa, &a.compressed.packed, &b.compressed.packed, |row, lanes| {
        let distance_to = |column: u32| {
            let distance =
                isa.squared_distance(&a.descriptors[row], &b.descriptors[column as usize]);
            column_neighbours[column as usize].update(row as u32, distance);
            distance
        };
        decisions.push(decide_row(&lanes, bound, &acceptance, distance_to));
    });

    let undecided: Vec<u32> = (0..)
        .zip(&decisions)
        .filter(|(_, d)| matches!(d, RowDecision::Undecided))
        .map(|(i, _)| i)
        .collect();
    if undecided.len() as f64 > MAX_UNDECIDED_RATIO * a.len() as f64 {
        return None;
    }
    for (&row, nearest) in undecided.iter().zip(nearest_of(isa, a, &undecided, b)) {
        decisions[row as usize] = if acceptance.accepts(&nearest) {
            let computed = &mut column_neighbours[nearest.index as usize];
            // If the distance was computed before, it must not become the second distance too.
            if computed.index != row {
                computed.update(row, nearest.distance);
            }
            RowDecision::Accepted(nearest.index, nearest.distance)
        } else {
            RowDecision::Rejected
        };
    }

    // The cross check: the tests of the columns.
    let mut matches = Vec::new();
    let mut undecided = Vec::new();
    for (row, decision) in (0..).zip(&decisions) {
        let &RowDecision::Accepted(column, distance) = decision else { continue };
        let (computed, bounded) =
            (&column_neighbours[column as usize], &column_bounds[column as usize]);
        let with_second = |second| acceptance.accepts(&Nearest { index: row, distance, second });
        if computed.index != row || !with_second(computed.second) {
            continue;
        }
        let others = bound.of(if bounded.index == row { bounded.second } else { bounded.distance });
        if !(others > distance && with_second(others)) {
            undecided.push((matches.len(), column));
        }
        matches.push(Match { a: row, b: column, distance: distance.into() });
    }
    let columns: Vec<u32> = undecided.iter().map(|&(_, column)| column).collect();
    let mut is_match = vec![true; matches.len()];
    for (&(at, _), nearest) in undecided.iter().zip(nearest_of(isa, b, &columns, a)) {
        is_match[at] = nearest.index == matches[at].a && acceptance.accepts(&nearest);
    }
    let mut is_match = is_match.into_iter();
    matches.retain(|_| is_match.next().unwrap_or(false));
    Some(matches)
}

/// The nearest neighbours of the descriptors `indices` of one image among all descriptors of
/// another.
fn nearest_of(isa: Isa, of: &Prepared, indices: &[u32], among: &Prepared) -> Vec<Nearest> {
    compare(isa, among, &of.pack(indices), |_, _| ())
}

/// Computes exact distances in ascending order of their bounds until the row is decided.
fn decide_row(
    lanes: &RowLanes<'_>,
    bound: DistanceBound,
    acceptance: &Acceptance,
    mut distance_to: impl FnMut(u32) -> u32,
) -> RowDecision {
    const MAX_LANES: usize = 16;
    let mut candidates = [(u32::MAX, u32::MAX); MAX_LANES];
    let mut rest = u32::MAX;
    for (candidate, lane) in candidates.iter_mut().zip(lanes.nearest()) {
        *candidate = (lane.distance, lane.index);
        rest = rest.min(lane.second);
    }
    let mut computed = Nearest::NONE;
    for at in 0..MAX_LANES {
        // Moves the smallest remaining candidate to the front.
        let nearest = (at..MAX_LANES).min_by_key(|&i| candidates[i]).unwrap_or(at);
        candidates.swap(at, nearest);
        let (compressed, index) = candidates[at];
        // Lower bound of all distances that are not computed yet.
        let others = bound.of(compressed.min(rest));
        if at > 0 {
            let best_case = Nearest {
                index: computed.index,
                distance: computed.distance.min(others),
                second: computed.second,
            };
            if !acceptance.accepts(&best_case) {
                return RowDecision::Rejected;
            }
            let second = computed.second.min(others);
            if others > computed.distance && acceptance.accepts(&Nearest { second, ..computed }) {
                return RowDecision::Accepted(computed.index, computed.distance);
            }
        }
        if compressed == u32::MAX {
            break;
        }
        computed.update(index, distance_to(index));
    }
    RowDecision::Undecided
}

#[cfg(test)]
mod tests;
