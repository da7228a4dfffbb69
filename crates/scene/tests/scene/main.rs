//! The tests of this crate, as one program.

#![allow(clippy::unwrap_used)] // the lint knows test functions, not their helpers

mod operations;
mod validate;
