//! The crate's tests, in one program.

#![allow(clippy::unwrap_used)] // the lint knows test functions, not their helpers

use tiepoint_features::SiftDescriptor;
use tiepoint_matching::{Match, Options, match_features};

mod any_kind;
mod brute;
mod matcher;
mod photos;
#[path = "../../../../tests/skipped.rs"]
mod skipped;

fn match_sift(a: &[SiftDescriptor], b: &[SiftDescriptor], options: &Options) -> Vec<Match> {
    match_features(&a.to_vec().into(), &b.to_vec().into(), options)
}
