//! Vectors of four or eight numbers, with the processor's vector instructions or without.
//!
//! The vectors are explicit because the compiler vectorises the wrong one of nested loops over
//! small arrays.

#[cfg(target_arch = "x86_64")]
mod fused;
mod instruction_set;
mod portable;
mod vector;

pub(super) use instruction_set::{dispatch, run_narrow};
pub(super) use vector::{Isa, Kernel, LANES, Stored, Vector, WIDE};
