//! The crate's tests, in one program.

#![allow(clippy::unwrap_used)] // the lint knows test functions, not their helpers

mod colmap_cameras;
mod laws;
mod opencv;
mod robust;
mod solvers;
mod two_views;
