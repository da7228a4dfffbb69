//! The crate's tests, in one program.

#![allow(clippy::unwrap_used)] // the lint knows test functions, not their helpers

mod drives;
mod evaluation;
#[path = "../../../../tests/skipped.rs"]
mod skipped;
