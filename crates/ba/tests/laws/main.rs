//! The crate's tests, in one program.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // the lints know test functions, not their helpers

mod jacobians;
mod linear_solvers;
mod scene;
