//! The kernels for x86-64: AVX-512 VNNI, AVX-VNNI and AVX2.
//!
//! VNNI multiplies four unsigned bytes by four signed bytes and adds them to 32 bits without
//! saturation. Row bytes are therefore stored as `a − 128`. The similar instruction of AVX2,
//! `vpmaddubsw`, saturates at 16 bits if both operands use 8 bits. For full descriptors the AVX2
//! kernel widens bytes to 16 bits and uses `vpmaddwd`, half as many products in an instruction.
//! Compressed descriptors are bounded so that `vpmaddubsw` does not saturate and 16 bits hold the
//! scores: 16 columns in a vector instead of 8.
//!
//! The wrappers enable the target features; the generic kernel and the intrinsics are inlined into
//! them. Tile sizes are the largest for which the products, one row of columns and one temporary
//! fit into the 32 or 16 registers.

use std::arch::x86_64::*;

use tiepoint_features::SiftDescriptor;

use super::kernel::compare_all;
use super::lanes::{KeyLanes, Lanes, OFFSET, ScoreLanes, widen, widen_signed};
use super::screen::for_each_candidate;
use crate::matches::Nearest;
use crate::packed::{MAX_ENTRY, PANEL, Packed, Panel, Vectors};

/// XOR with this word maps each byte `x` to `x − 128` as a signed byte.
const SIGN_BITS: u32 = 0x8080_8080;
/// Subtraction of this word maps the bytes of columns to 0 to `2 MAX_ENTRY`.
const NARROW_SHIFT: u32 = (OFFSET - MAX_ENTRY) as u32 * 0x0101_0101;

#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
pub(super) fn compare_all_avx512_vnni<const G: usize>(
    a: &impl Vectors<G>,
    b: &Packed<G>,
) -> [Vec<Nearest>; 2] {
    // SAFETY: the features that `Avx512Vnni` needs are enabled here.
    unsafe { compare_all::<Avx512Vnni, 6, 4, G>(a, b) }
}

#[target_feature(enable = "avx2,avxvnni")]
pub(super) fn compare_all_avx_vnni<const G: usize>(
    a: &impl Vectors<G>,
    b: &Packed<G>,
) -> [Vec<Nearest>; 2] {
    // SAFETY: the features that `AvxVnni` needs are enabled here.
    unsafe { compare_all::<AvxVnni, 6, 2, G>(a, b) }
}

#[target_feature(enable = "avx2")]
pub(super) fn compare_all_avx2<const G: usize>(
    a: &impl Vectors<G>,
    b: &Packed<G>,
) -> [Vec<Nearest>; 2] {
    // SAFETY: the features that `Avx2` needs are enabled here.
    unsafe { compare_all::<Avx2, 6, 2, G>(a, b) }
}

#[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
pub(super) fn for_each_candidate_avx512_vnni<const G: usize>(
    rows: &impl Vectors<G>,
    columns: &Packed<G>,
    min_scores: &mut [i32],
    on_candidate: impl FnMut(usize, u32, &mut i32) -> Option<()>,
) -> Option<()> {
    // SAFETY: the features that `Avx512Vnni` needs are enabled here.
    unsafe { for_each_candidate::<Avx512Vnni, 6, 4, G>(rows, columns, min_scores, on_candidate) }
}

#[target_feature(enable = "avx2,avxvnni")]
pub(super) fn for_each_candidate_avx_vnni<const G: usize>(
    rows: &impl Vectors<G>,
    columns: &Packed<G>,
    min_scores: &mut [i32],
    on_candidate: impl FnMut(usize, u32, &mut i32) -> Option<()>,
) -> Option<()> {
    // SAFETY: the features that `AvxVnni` needs are enabled here.
    unsafe { for_each_candidate::<AvxVnni, 6, 2, G>(rows, columns, min_scores, on_candidate) }
}

#[target_feature(enable = "avx2")]
pub(super) fn for_each_candidate_avx2<const G: usize>(
    rows: &impl Vectors<G>,
    columns: &Packed<G>,
    min_scores: &mut [i32],
    on_candidate: impl FnMut(usize, u32, &mut i32) -> Option<()>,
) -> Option<()> {
    // SAFETY: the features that `Avx2Narrow` needs are enabled here.
    unsafe { for_each_candidate::<Avx2Narrow, 6, 2, G>(rows, columns, min_scores, on_candidate) }
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
/// 16 lanes of 16 bits, two bytes per step.
struct Avx2Narrow;

impl Lanes for Avx512Vnni {
    type Vector = __m512i;
    const LANES: usize = 16;
    const WORDS: usize = 16;
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
    unsafe fn max(x: __m512i, y: __m512i) -> __m512i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm512_max_epi32(x, y) }
    }
}

impl KeyLanes for Avx512Vnni {
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
}

impl ScoreLanes for Avx512Vnni {
    type Mask = __mmask16;
    const IS_NARROW: bool = false;

    #[inline(always)]
    unsafe fn is_above(x: __m512i, y: __m512i) -> __mmask16 {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm512_cmpgt_epi32_mask(x, y) }
    }
    #[inline(always)]
    unsafe fn or(x: __mmask16, y: __mmask16) -> __mmask16 {
        x | y
    }
    #[inline(always)]
    unsafe fn is_any(mask: __mmask16) -> bool {
        mask != 0
    }
    #[inline(always)]
    unsafe fn bits(mask: __mmask16) -> u32 {
        mask.into()
    }
}

/// The methods that the lanes of 256 bits share.
macro_rules! lanes_256 {
    () => {
        type Vector = __m256i;
        const WORDS: usize = 8;

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
    };
}

/// The methods that the lanes of 8 × 32 bits share.
macro_rules! lanes_8x32 {
    () => {
        lanes_256!();
        const LANES: usize = 8;

        #[inline(always)]
        unsafe fn subtract(x: __m256i, y: __m256i) -> __m256i {
            // SAFETY: guaranteed by the caller, as the trait requires.
            unsafe { _mm256_sub_epi32(x, y) }
        }
        #[inline(always)]
        unsafe fn max(x: __m256i, y: __m256i) -> __m256i {
            // SAFETY: guaranteed by the caller, as the trait requires.
            unsafe { _mm256_max_epi32(x, y) }
        }
    };
}

/// The methods of keys in 8 × 32 bits.
macro_rules! keys_8x32 {
    () => {
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
    };
}

/// The masks of 256 bits.
macro_rules! masks_256 {
    () => {
        type Mask = __m256i;

        #[inline(always)]
        unsafe fn or(x: __m256i, y: __m256i) -> __m256i {
            // SAFETY: guaranteed by the caller, as the trait requires.
            unsafe { _mm256_or_si256(x, y) }
        }
        #[inline(always)]
        unsafe fn is_any(mask: __m256i) -> bool {
            // SAFETY: guaranteed by the caller, as the trait requires.
            unsafe { _mm256_movemask_epi8(mask) != 0 }
        }
    };
}

impl Lanes for AvxVnni {
    lanes_8x32!();
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

impl KeyLanes for AvxVnni {
    keys_8x32!();
}

impl ScoreLanes for AvxVnni {
    masks_256!();
    const IS_NARROW: bool = false;

    #[inline(always)]
    unsafe fn is_above(x: __m256i, y: __m256i) -> __m256i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm256_cmpgt_epi32(x, y) }
    }
    #[inline(always)]
    unsafe fn bits(mask: __m256i) -> u32 {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm256_movemask_ps(_mm256_castsi256_ps(mask)) as u32 }
    }
}

impl Lanes for Avx2 {
    lanes_8x32!();
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

impl KeyLanes for Avx2 {
    keys_8x32!();
}

impl Lanes for Avx2Narrow {
    lanes_256!();
    const LANES: usize = 16;
    const STEPS: usize = 2;

    /// The bytes 0 and 1, and the bytes 2 and 3, each twice.
    #[inline(always)]
    unsafe fn row_words(word: u32) -> [i32; 2] {
        let signed = word ^ SIGN_BITS;
        [signed & 0xFFFF, signed >> 16].map(|pair| (pair << 16 | pair) as i32)
    }
    /// The bytes 0 and 1 of sixteen columns, and their bytes 2 and 3, less [`NARROW_SHIFT`].
    #[inline(always)]
    unsafe fn columns<const G: usize>(panels: &[Panel<G>], buffer: &mut [i32]) -> *const i32 {
        let groups = panels.iter().flat_map(|panel| &panel.0);
        for (group, words) in groups.zip(buffer.as_chunks_mut::<PANEL>().0) {
            let (low, high) = words.split_at_mut(PANEL / 2);
            for (two, (low, high)) in group.as_chunks::<2>().0.iter().zip(low.iter_mut().zip(high))
            {
                let [first, second] = two.map(|word| word - NARROW_SHIFT);
                *low = (second << 16 | first & 0xFFFF) as i32;
                *high = (second & 0xFFFF_0000 | first >> 16) as i32;
            }
        }
        buffer.as_ptr()
    }
    #[inline(always)]
    unsafe fn multiply_add(sum: __m256i, column: __m256i, row: __m256i) -> __m256i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm256_add_epi16(sum, _mm256_maddubs_epi16(column, row)) }
    }
    #[inline(always)]
    unsafe fn subtract(x: __m256i, y: __m256i) -> __m256i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm256_sub_epi16(x, y) }
    }
    #[inline(always)]
    unsafe fn max(x: __m256i, y: __m256i) -> __m256i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm256_max_epi16(x, y) }
    }
}

impl ScoreLanes for Avx2Narrow {
    masks_256!();
    const IS_NARROW: bool = true;

    #[inline(always)]
    unsafe fn is_above(x: __m256i, y: __m256i) -> __m256i {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe { _mm256_cmpgt_epi16(x, y) }
    }
    #[inline(always)]
    unsafe fn bits(mask: __m256i) -> u32 {
        // SAFETY: guaranteed by the caller, as the trait requires.
        unsafe {
            let (low, high) = (_mm256_castsi256_si128(mask), _mm256_extracti128_si256::<1>(mask));
            _mm_movemask_epi8(_mm_packs_epi16(low, high)) as u32
        }
    }
}
