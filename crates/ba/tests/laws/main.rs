//! Integration tests of the crate, as one program.

// Clippy recognises test functions, but not their helpers.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

mod bad_input;
mod bal;
mod clustered_covariance;
mod convergence;
mod covariance;
#[path = "../../examples/bal/file.rs"]
mod file;
mod jacobians;
mod linear_solvers;
mod nist;
#[path = "../../examples/rig/stereo.rs"]
mod rig;
mod scene;
#[path = "../../../../tests/skipped.rs"]
mod skipped;
#[path = "../../examples/bal/snavely.rs"]
mod snavely;
mod spanning_tree;
mod stereo;
