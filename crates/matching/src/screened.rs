//! The matches that comparing all with all gives, for a third of the work.
//!
//! All pairs are compared by the short forms of their descriptors ([`crate::screen`]), which bound
//! the distances from below. A feature whose nearest neighbour cannot pass the ratio test any more
//! is done with as soon as two distances are known, and so is one whose nearest neighbour passes it
//! however near the others may be. The few left over, and the columns of matches that stay in
//! doubt, are compared in full. Nothing is approximated: the matches are the same, to the last bit.

use crate::accept::Acceptance;
use crate::brute::{Isa, RowLanes, compare};
use crate::matches::{Match, Nearest};
use crate::options::Options;
use crate::prepared::Prepared;
use crate::screen::Bound;

/// Fewer pairs of descriptors are compared in full right away.
const MIN_PAIRS: usize = 500 * 500;
/// If more than this share of the features is left over, all are compared in full.
const MAX_LEFT_OVER: f64 = 0.3;

/// What is known of a row.
enum Verdict {
    /// No partner passes the tests.
    Rejected,
    /// The only partner that can, and how far away it is.
    Accepted(u32, u32),
    /// It takes all distances to tell.
    Open,
}

/// The matches between two images, ascending in `a`; `None` where the short way would not be one.
/// Only for mutual matches.
pub(crate) fn match_screened(
    isa: Isa,
    a: &Prepared,
    b: &Prepared,
    options: &Options,
) -> Option<Vec<Match>> {
    if a.len() * b.len() < MIN_PAIRS {
        return None;
    }
    let acceptance = Acceptance::new(options);
    let bound = a.screen.bound(&b.screen);
    let mut verdicts = Vec::with_capacity(a.len());
    // The nearest two among the distances that were computed.
    let mut known_to_columns = vec![Nearest::NONE; b.len()];
    let columns = compare(isa, &a.screen.packed, &b.screen.packed, |row, lanes| {
        let distance_to = |column: u32| {
            let distance =
                isa.squared_distance(&a.descriptors[row], &b.descriptors[column as usize]);
            known_to_columns[column as usize].offer(row as u32, distance);
            distance
        };
        verdicts.push(judge(&lanes, bound, &acceptance, distance_to));
    });

    let open: Vec<u32> =
        (0..).zip(&verdicts).filter(|(_, v)| matches!(v, Verdict::Open)).map(|(i, _)| i).collect();
    if open.len() as f64 > MAX_LEFT_OVER * a.len() as f64 {
        return None;
    }
    for (&row, nearest) in open.iter().zip(nearest_of(isa, a, &open, b)) {
        verdicts[row as usize] = if acceptance.accepts(&nearest) {
            let known = &mut known_to_columns[nearest.index as usize];
            // The distance may be among those computed already; it must not become its own rival.
            if known.index != row {
                known.offer(row, nearest.distance);
            }
            Verdict::Accepted(nearest.index, nearest.distance)
        } else {
            Verdict::Rejected
        };
    }

    // The same from the other side.
    let mut matches = Vec::new();
    let mut open = Vec::new();
    for (row, verdict) in (0..).zip(&verdicts) {
        let &Verdict::Accepted(column, distance) = verdict else { continue };
        let (known, short) = (&known_to_columns[column as usize], &columns[column as usize]);
        let with_second = |second| acceptance.accepts(&Nearest { index: row, distance, second });
        if known.index != row || !with_second(known.second) {
            continue;
        }
        let others = bound.of(if short.index == row { short.second } else { short.distance });
        if !(others > distance && with_second(others)) {
            open.push((matches.len(), column));
        }
        matches.push(Match { a: row, b: column, distance });
    }
    let columns: Vec<u32> = open.iter().map(|&(_, column)| column).collect();
    let mut is_match = vec![true; matches.len()];
    for (&(at, _), nearest) in open.iter().zip(nearest_of(isa, b, &columns, a)) {
        is_match[at] = nearest.index == matches[at].a && acceptance.accepts(&nearest);
    }
    let mut is_match = is_match.into_iter();
    matches.retain(|_| is_match.next().unwrap_or(false));
    Some(matches)
}

/// The nearest neighbours of some descriptors of one image among all of another.
fn nearest_of(isa: Isa, of: &Prepared, indices: &[u32], among: &Prepared) -> Vec<Nearest> {
    compare(isa, among, &of.pack(indices), |_, _| ())
}

/// Computes distances, the most promising first, until the row is decided.
fn judge(
    lanes: &RowLanes<'_>,
    bound: Bound,
    acceptance: &Acceptance,
    mut distance_to: impl FnMut(u32) -> u32,
) -> Verdict {
    const MOST_LANES: usize = 16;
    let mut candidates = [(u32::MAX, u32::MAX); MOST_LANES];
    let mut rest = u32::MAX;
    for (candidate, lane) in candidates.iter_mut().zip(lanes.nearest()) {
        *candidate = (lane.distance, lane.index);
        rest = rest.min(lane.second);
    }
    let mut known = Nearest::NONE;
    for at in 0..MOST_LANES {
        // The nearest of those that are left, to the front.
        let nearest = (at..MOST_LANES).min_by_key(|&i| candidates[i]).unwrap_or(at);
        candidates.swap(at, nearest);
        let (short, index) = candidates[at];
        // Everything that was not computed yet is no nearer than this.
        let others = bound.of(short.min(rest));
        if at > 0 {
            let least = Nearest {
                index: known.index,
                distance: known.distance.min(others),
                second: known.second,
            };
            if !acceptance.accepts(&least) {
                return Verdict::Rejected;
            }
            let second = known.second.min(others);
            if others > known.distance && acceptance.accepts(&Nearest { second, ..known }) {
                return Verdict::Accepted(known.index, known.distance);
            }
        }
        if short == u32::MAX {
            break;
        }
        known.offer(index, distance_to(index));
    }
    Verdict::Open
}

#[cfg(test)]
mod tests;
