//! The crate's tests, in one program.

#![allow(clippy::unwrap_used)] // the lint knows test functions, not their helpers

mod calibration;
mod colmap;
mod common;
mod database;
mod dense;
mod exports;
mod faults;
mod formats;
mod hostile_database;
mod hostile_models;
mod hostile_numbers;
mod las;
mod las_claims;
mod rig_calibration;
#[path = "../../../../tests/skipped.rs"]
mod skipped;
