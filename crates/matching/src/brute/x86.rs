//! The kernel for x86-64: AVX-512 VNNI, AVX-VNNI and AVX2.
//!
//! VNNI multiplies four unsigned bytes by four signed bytes and adds them to 32 bits without
//! saturation. Row bytes are therefore stored as `a − 128`. The similar instruction of AVX2,
//! `vpmaddubsw`, saturates at 16 bits if both operands use 8 bits. The AVX2 kernel widens bytes to
//! 16 bits and uses `vpmaddwd`, which computes as many products per cycle on CPUs that execute both
//! on two ports.
//!
//! The wrappers enable the target features; the generic kernel and the intrinsics are inlined into
//! them. Tile sizes are the largest for which the products, one row of columns and one temporary
//! fit into the 32 or 16 registers.

use std::arch::x86_64::*;

use tiepoint_features::SiftDescriptor;

use super::kernel::{RowLanes, Totals, compare_all};
use super::lanes::{Lanes, widen, widen_signed};
use crate::packed::{Packed, Panel, Vectors};

/// XOR with this word maps each byte `x` to `x − 128` as a signed byte.
const SIGN_BITS: u32 = 0x8080_8080;

#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
pub(super) fn compare_all_avx512_vnni<const G: usize>(
    a: &impl Vectors<G>,
    b: &Packed<G>,
    finish_row: impl FnMut(usize, RowLanes<'_>),
) -> Totals {
    // SAFETY: the features that `Avx512Vnni` needs are enabled here.
    unsafe { compare_all::<Avx512Vnni, 6, 4, G>(a, b, finish_row) }
}

#[target_feature(enable = "avx2,avxvnni")]
pub(super) fn compare_all_avx_vnni<const G: usize>(
    a: &impl Vectors<G>,
    b: &Packed<G>,
    finish_row: impl FnMut(usize, RowLanes<'_>),
) -> Totals {
    // SAFETY: the features that `AvxVnni` needs are enabled here.
    unsafe { compare_all::<AvxVnni, 6, 2, G>(a, b, finish_row) }
}

#[target_feature(enable = "avx2")]
pub(super) fn compare_all_avx2<const G: usize>(
    a: &impl Vectors<G>,
    b: &Packed<G>,
    finish_row: impl FnMut(usize, RowLanes<'_>),
) -> Totals {
    // SAFETY: the features that `Avx2` needs are enabled here.
    unsafe { compare_all::<Avx2, 6, 2, G>(a, b, finish_row) }
}

/// Squared Euclidean distance, exact.
#[target_feature(enable = "avx2")]
pub(super) fn squared_distance(a: &SiftDescriptor, b: &SiftDescriptor) -> u32 {
    let mut sum = _mm256_setzero_si256();
    for (a, b) in a.as_chunks::<16>().0.iter().zip(b.as_chunks::<16>().0) {
        // SAFETY: both have 16 bytes.
        let [a, b] = [a, b].map(|x| unsafe { _mm_loadu_si128(x.as_ptr().cast()) });
        let difference = _mm256_sub_epi16(_mm256_cvtepu8_epi16(a), _mm256_cvtepu8_epi16(b));
        sum = _mm256_add_epi32(sum, _mm256_madd_epi16(difference, difference));
    }
    let mut lanes = [0_u32; 8];
    // SAFETY: the array has eight integers.
    unsafe { _mm256_storeu_si256(lanes.as_mut_ptr().cast(), sum) };
    lanes.iter().sum()
}

/// 16 lanes, four bytes per step.
struct Avx512Vnni;
/// 8 lanes, four bytes per step.
struct AvxVnni;
/// 8 lanes, two 16-bit integers per step.
struct Avx2;

impl Lanes for Avx512Vnni {
    type Vector = __m512i;
    const LANES: usize = 16;
    const STEPS: usize = 1;

    #[inline(always)]
    unsafe fn row_words(word: u32) -> [i32; 2] {
        [(word ^ SIGN_BITS) as i32, 0]
    }
    #[inline(always)]
    unsafe fn columns<const G: usize>(panels: &[Panel<G>], _buffer: &mut [i32]) -> *const i32 {
        panels.as_ptr().cast()
    }
    #[inline(always)]
    unsafe fn load(from: *const i32) -> __m512i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm512_loadu_epi32(from) }
    }
    #[inline(always)]
    unsafe fn store(to: *mut i32, v: __m512i) {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm512_storeu_epi32(to, v) }
    }
    #[inline(always)]
    unsafe fn splat(x: i32) -> __m512i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm512_set1_epi32(x) }
    }
    #[inline(always)]
    unsafe fn multiply_add(sum: __m512i, column: __m512i, row: __m512i) -> __m512i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm512_dpbusd_epi32(sum, column, row) }
    }
    #[inline(always)]
    unsafe fn subtract(x: __m512i, y: __m512i) -> __m512i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm512_sub_epi32(x, y) }
    }
    #[inline(always)]
    unsafe fn shift_left<const BITS: u32>(x: __m512i) -> __m512i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm512_slli_epi32::<BITS>(x) }
    }
    #[inline(always)]
    unsafe fn min(x: __m512i, y: __m512i) -> __m512i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm512_min_epi32(x, y) }
    }
    #[inline(always)]
    unsafe fn max(x: __m512i, y: __m512i) -> __m512i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm512_max_epi32(x, y) }
    }
}

/// The methods that AVX-VNNI and AVX2 share.
macro_rules! lanes_256 {
    () => {
        type Vector = __m256i;
        const LANES: usize = 8;

        #[inline(always)]
        unsafe fn load(from: *const i32) -> __m256i {
            // SAFETY: guaranteed by the caller, as the trait requires.
            unsafe { _mm256_loadu_si256(from.cast()) }
        }
        #[inline(always)]
        unsafe fn store(to: *mut i32, v: __m256i) {
            // SAFETY: guaranteed by the caller, as the trait requires.
            unsafe { _mm256_storeu_si256(to.cast(), v) }
        }
        #[inline(always)]
        unsafe fn splat(x: i32) -> __m256i {
            // SAFETY: guaranteed by the caller, as the trait requires.
            unsafe { _mm256_set1_epi32(x) }
        }
        #[inline(always)]
        unsafe fn subtract(x: __m256i, y: __m256i) -> __m256i {
            // SAFETY: guaranteed by the caller, as the trait requires.
            unsafe { _mm256_sub_epi32(x, y) }
        }
        #[inline(always)]
        unsafe fn shift_left<const BITS: u32>(x: __m256i) -> __m256i {
            // SAFETY: guaranteed by the caller, as the trait requires.
            unsafe { _mm256_sll_epi32(x, _mm_cvtsi32_si128(BITS as i32)) }
        }
        #[inline(always)]
        unsafe fn min(x: __m256i, y: __m256i) -> __m256i {
            // SAFETY: guaranteed by the caller, as the trait requires.
            unsafe { _mm256_min_epi32(x, y) }
        }
        #[inline(always)]
        unsafe fn max(x: __m256i, y: __m256i) -> __m256i {
            // SAFETY: guaranteed by the caller, as the trait requires.
            unsafe { _mm256_max_epi32(x, y) }
        }
    };
}

impl Lanes for AvxVnni {
    lanes_256!();
    const STEPS: usize = 1;

    #[inline(always)]
    unsafe fn row_words(word: u32) -> [i32; 2] {
        [(word ^ SIGN_BITS) as i32, 0]
    }
    #[inline(always)]
    unsafe fn columns<const G: usize>(panels: &[Panel<G>], _buffer: &mut [i32]) -> *const i32 {
        panels.as_ptr().cast()
    }
    #[inline(always)]
    unsafe fn multiply_add(sum: __m256i, column: __m256i, row: __m256i) -> __m256i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm256_dpbusd_avx_epi32(sum, column, row) }
    }
}

impl Lanes for Avx2 {
    lanes_256!();
    const STEPS: usize = 2;

    #[inline(always)]
    unsafe fn row_words(word: u32) -> [i32; 2] {
        widen_signed(word)
    }
    #[inline(always)]
    unsafe fn columns<const G: usize>(panels: &[Panel<G>], buffer: &mut [i32]) -> *const i32 {
        widen(panels, buffer)
    }
    #[inline(always)]
    unsafe fn multiply_add(sum: __m256i, column: __m256i, row: __m256i) -> __m256i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm256_add_epi32(sum, _mm256_madd_epi16(column, row)) }
    }
}
