//! SIMD vectors of sixteen `f32`.
//!
//! The kernels of this crate are generic over [`Simd`] and compiled once per instruction set:
//! [`dispatch`] calls a function with the target features of the instruction set, into which all
//! functions marked `#[inline(always)]` are inlined. A lane computes the same IEEE operations on
//! each instruction set, and fused multiply-adds are fused on each. Reductions across lanes have a
//! fixed order. Results therefore have the same bits on all CPUs.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod isa;
mod lanes;
mod portable;

pub(crate) use isa::{Isa, dispatch};
pub(crate) use lanes::{LANES, Simd, Task};
