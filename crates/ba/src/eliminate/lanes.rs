//! Four numbers at once, with the machine's instructions for it or without.
//!
//! The vectors are explicit because the compiler, left alone with loops over small arrays, vectorises along the wrong one.

/// Numbers handled at once.
pub(super) const LANES: usize = 4;

/// How to work on [`LANES`] numbers. Products `a·b + c` are fused where the machine can, so that results differ in the last
/// bits between instruction sets, and not otherwise.
pub(super) trait Isa {
    /// The numbers.
    type V: Copy;
    fn load(from: &[f64; LANES]) -> Self::V;
    fn store(v: Self::V, to: &mut [f64; LANES]);
    fn splat(x: f64) -> Self::V;
    fn mul(a: Self::V, b: Self::V) -> Self::V;
    /// a b + c.
    fn mul_add(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// c − a b.
    fn neg_mul_add(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// a b + c for single numbers.
    fn mul_add_one(a: f64, b: f64, c: f64) -> f64;
}

pub(super) struct Portable;
impl Isa for Portable {
    type V = [f64; LANES];
    #[inline(always)]
    fn load(from: &[f64; LANES]) -> Self::V {
        *from
    }
    #[inline(always)]
    fn store(v: Self::V, to: &mut [f64; LANES]) {
        *to = v;
    }
    #[inline(always)]
    fn splat(x: f64) -> Self::V {
        [x; LANES]
    }
    #[inline(always)]
    fn mul(a: Self::V, b: Self::V) -> Self::V {
        std::array::from_fn(|i| a[i] * b[i])
    }
    #[inline(always)]
    fn mul_add(a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        std::array::from_fn(|i| a[i] * b[i] + c[i])
    }
    #[inline(always)]
    fn neg_mul_add(a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        std::array::from_fn(|i| c[i] - a[i] * b[i])
    }
    #[inline(always)]
    fn mul_add_one(a: f64, b: f64, c: f64) -> f64 {
        a * b + c
    }
}

/// AVX2 with fused multiply-add. To be used inside functions compiled for these only.
#[cfg(target_arch = "x86_64")]
pub(super) struct Fused;

#[cfg(target_arch = "x86_64")]
mod fused {
    use std::arch::x86_64::{
        __m256d, _mm256_fmadd_pd, _mm256_fnmadd_pd, _mm256_loadu_pd, _mm256_mul_pd, _mm256_set1_pd,
        _mm256_storeu_pd,
    };

    use super::{Fused, Isa, LANES};

    impl Isa for Fused {
        type V = __m256d;
        #[inline(always)]
        fn load(from: &[f64; LANES]) -> __m256d {
            // SAFETY: the instruction exists where `Fused` may be used, and reads what the reference covers.
            unsafe { _mm256_loadu_pd(from.as_ptr()) }
        }
        #[inline(always)]
        fn store(v: __m256d, to: &mut [f64; LANES]) {
            // SAFETY: the instruction exists where `Fused` may be used, and writes what the reference covers.
            unsafe { _mm256_storeu_pd(to.as_mut_ptr(), v) }
        }
        #[inline(always)]
        fn splat(x: f64) -> __m256d {
            // SAFETY: the instruction exists where `Fused` may be used.
            unsafe { _mm256_set1_pd(x) }
        }
        #[inline(always)]
        fn mul(a: __m256d, b: __m256d) -> __m256d {
            // SAFETY: the instruction exists where `Fused` may be used.
            unsafe { _mm256_mul_pd(a, b) }
        }
        #[inline(always)]
        fn mul_add(a: __m256d, b: __m256d, c: __m256d) -> __m256d {
            // SAFETY: the instruction exists where `Fused` may be used.
            unsafe { _mm256_fmadd_pd(a, b, c) }
        }
        #[inline(always)]
        fn neg_mul_add(a: __m256d, b: __m256d, c: __m256d) -> __m256d {
            // SAFETY: the instruction exists where `Fused` may be used.
            unsafe { _mm256_fnmadd_pd(a, b, c) }
        }
        #[inline(always)]
        fn mul_add_one(a: f64, b: f64, c: f64) -> f64 {
            a.mul_add(b, c)
        }
    }
}

/// The first [`LANES`] numbers.
#[inline(always)]
pub(super) fn lanes(slice: &[f64]) -> &[f64; LANES] {
    slice.first_chunk().expect("at least one vector")
}

/// The same, to be changed.
#[inline(always)]
pub(super) fn lanes_mut(slice: &mut [f64]) -> &mut [f64; LANES] {
    slice.first_chunk_mut().expect("at least one vector")
}
