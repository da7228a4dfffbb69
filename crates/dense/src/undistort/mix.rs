//! The weighted mean of four neighbouring colours, in integers: the same on all machines.

/// Bits of the weights of a pixel, which sum to 2¹².
pub(super) const WEIGHT_BITS: u32 = 12;
const HALF: u32 = 1 << (WEIGHT_BITS - 1);

/// The mean of the first two pixels of three bytes in each of two rows of eight bytes. `weights`:
/// of the upper row, and of the lower one.
#[cfg(target_arch = "x86_64")]
#[inline]
pub(super) fn mix_rgb(rows: [[u8; 8]; 2], weights: [[u16; 2]; 2]) -> [u8; 3] {
    // SAFETY: SSE2 is part of x86-64.
    unsafe { mix_rgb_sse2(rows, weights) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "sse2")]
#[inline]
fn mix_rgb_sse2(rows: [[u8; 8]; 2], weights: [[u16; 2]; 2]) -> [u8; 3] {
    use std::arch::x86_64::{
        _mm_add_epi32, _mm_cvtsi64_si128, _mm_cvtsi128_si32, _mm_madd_epi16, _mm_packs_epi32,
        _mm_packus_epi16, _mm_set1_epi32, _mm_setzero_si128, _mm_srli_epi32, _mm_unpacklo_epi8,
    };
    let zero = _mm_setzero_si128();
    let of_row = |row: [u8; 8], [left, right]: [u16; 2]| {
        // The channels of both pixels side by side.
        let row = i64::from_le_bytes(row);
        let pairs = _mm_unpacklo_epi8(_mm_cvtsi64_si128(row), _mm_cvtsi64_si128(row >> 24));
        let pairs = _mm_unpacklo_epi8(pairs, zero);
        let weights = u32::from(left) | u32::from(right) << 16;
        _mm_madd_epi16(pairs, _mm_set1_epi32(weights.cast_signed()))
    };
    let sum = _mm_add_epi32(of_row(rows[0], weights[0]), of_row(rows[1], weights[1]));
    let mean = _mm_srli_epi32::<12>(_mm_add_epi32(sum, _mm_set1_epi32(HALF.cast_signed())));
    let bytes = _mm_packus_epi16(_mm_packs_epi32(mean, mean), zero);
    let [red, green, blue, _] = _mm_cvtsi128_si32(bytes).to_le_bytes();
    [red, green, blue]
}

/// The mean of the first two pixels of three bytes in each of two rows of eight bytes. `weights`:
/// of the upper row, and of the lower one.
#[cfg(not(target_arch = "x86_64"))]
#[inline]
pub(super) fn mix_rgb(rows: [[u8; 8]; 2], weights: [[u16; 2]; 2]) -> [u8; 3] {
    mix_rgb_portable(rows, weights)
}

/// The slow twin.
#[cfg(any(test, not(target_arch = "x86_64")))]
fn mix_rgb_portable(rows: [[u8; 8]; 2], weights: [[u16; 2]; 2]) -> [u8; 3] {
    std::array::from_fn(|channel| {
        let pixels = rows.map(|row| [row[channel], row[3 + channel]]);
        mix(pixels, weights)
    })
}

/// The mean of two values in each of two rows.
#[inline]
pub(super) fn mix(values: [[u8; 2]; 2], weights: [[u16; 2]; 2]) -> u8 {
    let terms = values.iter().flatten().zip(weights.iter().flatten());
    let sum: u32 = terms.map(|(value, weight)| u32::from(*value) * u32::from(*weight)).sum();
    ((sum + HALF) >> WEIGHT_BITS) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quick_and_slow_means_are_equal() {
        let mut state = 1u32;
        let mut next = |end: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((u64::from(state) * u64::from(end)) >> 32) as u32
        };
        for step in 0..10_000 {
            let rows = [0, 1].map(|_| {
                std::array::from_fn(|_| if step % 7 == 0 { 255 } else { next(256) as u8 })
            });
            let (u, v) = (next(4097), next(4097));
            let both = (u * v) >> WEIGHT_BITS;
            let weights = [[4096 + both - u - v, u - both], [v - both, both]]
                .map(|row| row.map(|w| w as u16));
            assert_eq!(mix_rgb(rows, weights), mix_rgb_portable(rows, weights), "{rows:?}");
        }
        assert_eq!(mix([[255; 2]; 2], [[1024; 2]; 2]), 255);
    }
}
