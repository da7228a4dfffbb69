//! The crate's tests, in one program.

// The lints know test functions, not their helpers.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

mod common;
mod covariance;
mod gauge;
mod lens;
mod options;
mod selection;
#[path = "../../src/shared_lens.rs"]
mod shared_lens;
mod terms;
