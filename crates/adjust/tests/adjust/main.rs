//! The crate's tests, in one program.

#![allow(clippy::unwrap_used)] // the lint knows test functions, not their helpers

mod common;
mod gauge;
mod lens;
mod options;
mod selection;
#[path = "../../src/shared_lens.rs"]
mod shared_lens;
mod terms;
