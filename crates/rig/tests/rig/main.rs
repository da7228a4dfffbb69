//! Integration tests of the crate, as one program.

#![allow(clippy::unwrap_used)] // the lint knows test functions, not their helpers

mod laws;
mod time;
