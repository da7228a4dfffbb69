//! Sixteen lanes of `f32`, on whatever the machine has.
//!
//! Every kernel of this crate is written once, generic over [`Simd`], and compiled once per
//! instruction set: [`dispatch`] enters a function with the right target features, into which
//! everything marked `#[inline(always)]` is inlined. A lane computes exactly the same IEEE
//! operations on each instruction set (a multiply-add is fused everywhere or not written as one),
//! and nothing is ever reduced across lanes in an order that depends on the machine, so the results
//! have the same bits everywhere.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod isa;
mod lanes;
mod portable;

pub(crate) use isa::{Isa, dispatch};
pub(crate) use lanes::{LANES, Simd, Task};
