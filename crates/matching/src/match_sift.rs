//! Matching of image pairs with SIFT descriptors.

use crate::accept::Acceptance;
use crate::brute::{Isa, NearestBothWays, nearest, nearest_on};
use crate::matches::{Match, Nearest};
use crate::options::{Method, Options};
use crate::prepared::Prepared;
use crate::pruned::match_pruned;

/// Matches two images. Matches are in ascending order of `a`.
pub fn match_prepared(a: &Prepared, b: &Prepared, options: &Options) -> Vec<Match> {
    if is_preempted(a, b, options) {
        return Vec::new();
    }
    let found = match (options.method, &a.forest, &b.forest) {
        (Method::Forest(checks) | Method::Cheapest(checks), Some(forest_a), Some(forest_b))
            if options.method.uses_forest_for_pair(a.len(), b.len()) =>
        {
            NearestBothWays {
                of_a: forest_b.nearest_of(forest_a, checks),
                of_b: forest_a.nearest_of(forest_b, checks),
            }
        }
        _ => return match_prepared_on(Isa::best(), a, b, options),
    };
    select(&found, options)
}

/// Exact matching on a given instruction set, for tests and measurements: with pruning, which gives
/// the same matches faster, if it applies.
pub fn match_prepared_on(isa: Isa, a: &Prepared, b: &Prepared, options: &Options) -> Vec<Match> {
    let pruned = if options.mutual { match_pruned(isa, a, b, options) } else { None };
    pruned.unwrap_or_else(|| select(&nearest_on(isa, a, b), options))
}

/// Preemptive matching: whether the leading features have too few matches.
fn is_preempted(a: &Prepared, b: &Prepared, options: &Options) -> bool {
    let (Some(preempt), Some(a), Some(b)) = (options.preempt, &a.leading, &b.leading) else {
        return false;
    };
    select(&nearest(a, b), options).len() < preempt.min_matches as usize
}

/// Applies the ratio test, the maximum angle and the cross check of `options` to nearest
/// neighbours. Matches are in ascending order of `a`.
pub fn select(nearest: &NearestBothWays, options: &Options) -> Vec<Match> {
    let acceptance = Acceptance::new(options);
    let accepted_match = |(i, forward): (usize, &Nearest)| {
        let back = nearest.of_b.get(forward.index as usize)?;
        if options.mutual && (back.index as usize != i || !acceptance.accepts(back)) {
            return None;
        }
        acceptance.accepts(forward).then_some(Match {
            a: i as u32,
            b: forward.index,
            distance: forward.distance.into(),
        })
    };
    nearest.of_a.iter().enumerate().filter_map(accepted_match).collect()
}
