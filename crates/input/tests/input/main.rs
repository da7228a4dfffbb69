//! The crate's tests, in one program.

#![allow(clippy::unwrap_used)] // the lint knows test functions, not their helpers

mod folders;
mod hostile_images;
mod images;
