//! The colours of a row of a cell at once, with AVX2: the same bytes as pixel by pixel.

use tiepoint_simd::{Isa, Level};

use super::mix::WEIGHT_BITS;
use super::source_map::{CELL, FRACTION_BITS, RowWalk};

/// Relative to the centre of the first pixel, and rounded to [`WEIGHT_BITS`].
pub(super) const OFFSET: i64 =
    (1 << (FRACTION_BITS - 1)) - (1 << (FRACTION_BITS - WEIGHT_BITS - 1));

/// An image of three bytes a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rgb<'a> {
    pub(super) pixels: &'a [u8],
    pub(super) width: u32,
    pub(super) height: u32,
}

/// Sets the colours of a row of pixels at the places of a walk. Returns `false`, and sets nothing,
/// if a place is not between four pixels of the image or next to the end of the data, and where
/// `isa` has no AVX2: then pixels are to be computed one by one.
#[inline]
pub(super) fn mix(isa: Isa, image: Rgb<'_>, walk: &RowWalk, out: &mut [[u8; 3]; CELL]) -> bool {
    match isa.level() {
        // SAFETY: an `Isa` of these levels is only constructed after detection of AVX2.
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 | Level::Avx2 => unsafe { avx2::mix(image, walk, out) },
        Level::Portable => {
            let _ = (image, walk, out);
            false
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::*;

    const ONE: i32 = 1 << WEIGHT_BITS;
    /// Places in images of this size fit 31 bits.
    const MAX_SIZE: u32 = 1 << (31 - WEIGHT_BITS);
    /// Bytes that are read of each of the two rows of a pixel.
    const READ_BYTES: usize = 8;

    #[target_feature(enable = "avx2")]
    pub(super) fn mix(image: Rgb<'_>, walk: &RowWalk, out: &mut [[u8; 3]; CELL]) -> bool {
        let Rgb { pixels, width, height } = image;
        let row_bytes = width as usize * 3;
        // The last place from which both rows can be read.
        let Some(last) = pixels.len().checked_sub(row_bytes + READ_BYTES) else { return false };
        let (Ok(last), true) = (i32::try_from(last), width.max(height) < MAX_SIZE) else {
            return false;
        };
        let limit = |size: u32| _mm256_set1_epi64x((i64::from(size) - 1) << WEIGHT_BITS);
        let (x, y) = (places(&walk.0[0]), places(&walk.0[1]));
        let mut is_inside = _mm256_set1_epi64x(-1);
        for (axis, limit) in [(x, limit(width)), (y, limit(height))] {
            for quad in axis {
                is_inside = _mm256_and_si256(is_inside, _mm256_cmpgt_epi64(limit, quad));
            }
        }
        if _mm256_movemask_epi8(is_inside) != -1 {
            return false;
        }
        let mut mixed = [[0; 16]; 4];
        for half in 0..CELL / 8 {
            let [x, y] = [x, y].map(|axis| narrow(axis[2 * half], axis[2 * half + 1]));
            let index = _mm256_add_epi32(
                _mm256_mullo_epi32(
                    _mm256_srli_epi32::<12>(y),
                    _mm256_set1_epi32(width.cast_signed()),
                ),
                _mm256_srli_epi32::<12>(x),
            );
            let starts = _mm256_add_epi32(index, _mm256_add_epi32(index, index));
            if _mm256_movemask_epi8(_mm256_cmpgt_epi32(starts, _mm256_set1_epi32(last))) != 0 {
                return false;
            }
            let fraction = _mm256_set1_epi32(ONE - 1);
            let (u, v) = (_mm256_and_si256(x, fraction), _mm256_and_si256(y, fraction));
            let rounded = _mm256_add_epi32(_mm256_madd_epi16(u, v), _mm256_set1_epi32(ONE / 2));
            let both = _mm256_srli_epi32::<12>(rounded);
            let right = _mm256_sub_epi32(u, both);
            let left = _mm256_sub_epi32(_mm256_sub_epi32(_mm256_set1_epi32(ONE), v), right);
            // Weights of the left and of the right pixel, side by side.
            let top = _mm256_or_si256(left, _mm256_slli_epi32::<16>(right));
            let bottom = _mm256_or_si256(_mm256_sub_epi32(v, both), _mm256_slli_epi32::<16>(both));
            let mut start = [0; 8];
            // SAFETY: the array has 32 bytes.
            unsafe { _mm256_storeu_si256(start.as_mut_ptr().cast(), starts) };
            let two = |k: usize, below: usize| {
                // SAFETY: `start + row_bytes + READ_BYTES` is at most the length, for all eight.
                unsafe {
                    let at = |k: usize| pixels.as_ptr().add(start[k] as usize + below);
                    pairs(at(k), at(k + 4))
                }
            };
            // The k-th and the (k + 4)-th pixel.
            let means = [
                mean(
                    [two(0, 0), two(0, row_bytes)],
                    [_mm256_shuffle_epi32::<0x00>(top), _mm256_shuffle_epi32::<0x00>(bottom)],
                ),
                mean(
                    [two(1, 0), two(1, row_bytes)],
                    [_mm256_shuffle_epi32::<0x55>(top), _mm256_shuffle_epi32::<0x55>(bottom)],
                ),
                mean(
                    [two(2, 0), two(2, row_bytes)],
                    [_mm256_shuffle_epi32::<0xaa>(top), _mm256_shuffle_epi32::<0xaa>(bottom)],
                ),
                mean(
                    [two(3, 0), two(3, row_bytes)],
                    [_mm256_shuffle_epi32::<0xff>(top), _mm256_shuffle_epi32::<0xff>(bottom)],
                ),
            ];
            let words =
                [_mm256_packs_epi32(means[0], means[1]), _mm256_packs_epi32(means[2], means[3])];
            let bytes = _mm256_packus_epi16(words[0], words[1]);
            let three = _mm256_broadcastsi128_si256(_mm_setr_epi8(
                0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1,
            ));
            let bytes = _mm256_shuffle_epi8(bytes, three);
            // SAFETY: two elements have 32 bytes.
            unsafe { _mm256_storeu_si256(mixed[2 * half..].as_mut_ptr().cast(), bytes) };
        }
        let out: &mut [[[u8; 3]; 4]] = out.as_chunks_mut().0;
        for (out, mixed) in out.iter_mut().zip(&mixed) {
            out.as_flattened_mut().copy_from_slice(&mixed[..12]);
        }
        true
    }

    /// The places of the pixels of a row, in units of 2^−[`WEIGHT_BITS`] pixels, from the value and
    /// the forward differences. Negative places become large ones.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn places(cubic: &[i64; 4]) -> [__m256i; CELL / 4] {
        let [v, f, s, t] = cubic.map(|value| _mm256_set1_epi64x(value));
        let odd = _mm256_setr_epi64x(0, -1, 0, -1);
        let upper = _mm256_setr_epi64x(0, 0, -1, -1);
        let last = _mm256_setr_epi64x(0, 0, 0, -1);
        // The k-fold of a value, and its binomial (k over 2)-fold, for k = 0, 1, 2, 3.
        let times = |value: __m256i| {
            let double = _mm256_add_epi64(value, value);
            _mm256_add_epi64(_mm256_and_si256(value, odd), _mm256_and_si256(double, upper))
        };
        let triangle = |value: __m256i| {
            let double = _mm256_add_epi64(value, value);
            _mm256_add_epi64(_mm256_and_si256(value, upper), _mm256_and_si256(double, last))
        };
        let sum = |a, b, c| _mm256_add_epi64(_mm256_add_epi64(a, b), c);
        let mut value = _mm256_add_epi64(
            sum(_mm256_sub_epi64(v, _mm256_set1_epi64x(OFFSET)), times(f), triangle(s)),
            _mm256_and_si256(t, last),
        );
        let mut first = sum(f, times(s), triangle(t));
        let mut second = _mm256_add_epi64(s, times(t));
        let mut places = [value; CELL / 4];
        for place in &mut places {
            *place = _mm256_srli_epi64::<{ (FRACTION_BITS - WEIGHT_BITS) as i32 }>(value);
            // Four steps at once.
            let both = _mm256_add_epi64(second, t);
            let double = _mm256_add_epi64(second, second);
            let four = _mm256_slli_epi64::<2>(_mm256_add_epi64(first, both));
            value = sum(value, four, double);
            first = sum(first, _mm256_slli_epi64::<2>(both), _mm256_add_epi64(t, t));
            second = _mm256_add_epi64(second, _mm256_slli_epi64::<2>(t));
        }
        places
    }

    /// The lower halves of eight numbers.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn narrow(a: __m256i, b: __m256i) -> __m256i {
        let (a, b) = (_mm256_castsi256_ps(a), _mm256_castsi256_ps(b));
        let mixed = _mm256_castps_si256(_mm256_shuffle_ps::<0b10_00_10_00>(a, b));
        _mm256_permute4x64_epi64::<0b11_01_10_00>(mixed)
    }

    /// The channels of two neighbouring pixels side by side, for two places.
    ///
    /// # Safety
    /// [`READ_BYTES`] bytes can be read at each.
    #[target_feature(enable = "avx2")]
    #[inline]
    unsafe fn pairs(a: *const u8, b: *const u8) -> __m256i {
        // SAFETY: as above.
        let bytes = unsafe {
            let low = _mm_castsi128_pd(_mm_loadl_epi64(a.cast()));
            _mm_castpd_si128(_mm_loadh_pd(low, b.cast()))
        };
        let order = _mm256_broadcastsi128_si256(_mm_setr_epi8(
            0, 1, 6, 7, 2, 3, 8, 9, 4, 5, 10, 11, -1, -1, -1, -1,
        ));
        _mm256_shuffle_epi8(_mm256_cvtepu8_epi16(bytes), order)
    }

    /// The weighted means of pairs in the upper and in the lower row.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn mean(rows: [__m256i; 2], weights: [__m256i; 2]) -> __m256i {
        let sum = _mm256_add_epi32(
            _mm256_madd_epi16(rows[0], weights[0]),
            _mm256_madd_epi16(rows[1], weights[1]),
        );
        _mm256_srli_epi32::<12>(_mm256_add_epi32(sum, _mm256_set1_epi32(ONE / 2)))
    }
}
