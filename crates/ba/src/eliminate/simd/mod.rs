//! Four or eight numbers at once, with the machine's instructions for it or without.
//!
//! The vectors are explicit because the compiler, left alone with loops over small arrays,
//! vectorises along the wrong one.

#[cfg(target_arch = "x86_64")]
mod fused;
mod path;
mod portable;
mod vector;

pub(super) use path::{dispatch, run_narrow};
pub(super) use vector::{Isa, LANES, Stored, Task, Vector, WIDE};
