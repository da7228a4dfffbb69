//! Tests of dense reconstruction.

#![allow(clippy::unwrap_used)] // the lint knows test functions, not their helpers

mod colmap;
mod density;
mod drive;
mod undistort;
