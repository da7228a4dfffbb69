//! From nearest neighbours to matches.

use rayon::prelude::*;
use tiepoint_features::Descriptor;

use crate::accept::Acceptance;
use crate::brute::{Isa, NearestBothWays, nearest};
use crate::forest::ForestOptions;
use crate::matches::Match;
use crate::options::{Method, Options};
use crate::pairs::Pair;
use crate::prepared::Prepared;
use crate::screened::match_screened;

/// Matches the descriptors of two images; ascending in `a`. For images that are matched more than
/// once, prepare them and use [`match_prepared`].
pub fn match_features(a: &[Descriptor], b: &[Descriptor], options: &Options) -> Vec<Match> {
    let [a, b] = [a, b].map(|descriptors| {
        let mut prepared = Prepared::new(descriptors);
        if options.method.is_forest_for(a.len(), b.len()) {
            prepared.grow_forest(&ForestOptions::default());
        }
        prepared
    });
    match_prepared(&a, &b, options)
}

/// Matches two images; ascending in `a`.
pub fn match_prepared(a: &Prepared, b: &Prepared, options: &Options) -> Vec<Match> {
    if is_hopeless(a, b, options) {
        return Vec::new();
    }
    let found = match (options.method, &a.forest, &b.forest) {
        (Method::Forest(checks) | Method::Cheapest(checks), Some(forest_a), Some(forest_b))
            if options.method.is_forest_for(a.len(), b.len()) =>
        {
            NearestBothWays {
                of_a: forest_b.nearest_of(forest_a, checks),
                of_b: forest_a.nearest_of(forest_b, checks),
            }
        }
        _ => return match_by_brute_force(a, b, options),
    };
    select(&found, options)
}

/// By comparing all with all, or by what gives the same matches sooner.
fn match_by_brute_force(a: &Prepared, b: &Prepared, options: &Options) -> Vec<Match> {
    let screened = if options.mutual { match_screened(Isa::best(), a, b, options) } else { None };
    screened.unwrap_or_else(|| select(&nearest(a, b), options))
}

/// Matches many pairs of images, in parallel over pairs; one list for each pair, in the same order.
/// Every index in `pairs` must be one into `images`.
pub fn match_pairs(images: &[Prepared], pairs: &[Pair], options: &Options) -> Vec<Vec<Match>> {
    pairs
        .par_iter()
        .map(|&(i, j)| match_prepared(&images[i as usize], &images[j as usize], options))
        .collect()
}

/// Whether the leading features of the two images say that they have nothing in common.
fn is_hopeless(a: &Prepared, b: &Prepared, options: &Options) -> bool {
    let (Some(preempt), Some(a), Some(b)) = (options.preempt, &a.leading, &b.leading) else {
        return false;
    };
    select(&nearest(a, b), options).len() < preempt.min_matches as usize
}

/// Applies the tests of `options` to nearest neighbours; ascending in `a`.
pub fn select(nearest: &NearestBothWays, options: &Options) -> Vec<Match> {
    let acceptance = Acceptance::new(options);
    let is_match = |(i, forward): (usize, &crate::Nearest)| {
        let back = nearest.of_b.get(forward.index as usize)?;
        if options.mutual && (back.index as usize != i || !acceptance.accepts(back)) {
            return None;
        }
        acceptance.accepts(forward).then_some(Match {
            a: i as u32,
            b: forward.index,
            distance: forward.distance,
        })
    };
    nearest.of_a.iter().enumerate().filter_map(is_match).collect()
}
