//! The kernel with AVX-512: 16 samples a register.

use std::arch::x86_64::*;

use super::constants::{MIDDLE, OUTSIDE, STEPS};
use super::kernel::{Ncc, Task, Warp, cost_of};
use super::patch::{DX, DY, Patch};
use super::source::Source;

/// Type parameter of [`Task::run`]. Only [`enter`] uses it.
#[derive(Clone, Copy)]
struct Avx512;

/// Runs `task` in a function that is compiled for AVX-512.
#[target_feature(enable = "avx512f,avx512bw")]
pub(super) fn enter<T: Task>(task: T) -> T::Output {
    task.run::<Avx512>()
}

impl Ncc for Avx512 {
    #[inline(always)]
    fn cost(source: &Source, warp: &Warp, patch: &Patch) -> f32 {
        // SAFETY: this method is only inlined into `enter`, whose callers have detected the
        // instruction set. Samples are loaded only after their positions were found inside.
        unsafe {
            let [x_limit, y_limit] = source.limits().map(|limit| _mm512_set1_ps(limit));
            let zero = _mm512_setzero_ps();
            let mut sums = [zero; 3];
            for half in 0..2 {
                let dx = _mm512_loadu_ps(DX[half].as_ptr());
                let dy = _mm512_loadu_ps(DY[half].as_ptr());
                let at = |axis: usize| {
                    let step = _mm512_add_ps(
                        _mm512_mul_ps(_mm512_set1_ps(warp.dx[axis]), dx),
                        _mm512_mul_ps(_mm512_set1_ps(warp.dy[axis]), dy),
                    );
                    _mm512_add_ps(_mm512_set1_ps(warp.centre[axis]), step)
                };
                let z = at(2);
                let inverse = _mm512_div_ps(_mm512_set1_ps(1.0), z);
                let (x, y) = (_mm512_mul_ps(at(0), inverse), _mm512_mul_ps(at(1), inverse));
                let is_inside = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(z, zero)
                    & _mm512_cmp_ps_mask::<_CMP_GE_OQ>(x, zero)
                    & _mm512_cmp_ps_mask::<_CMP_GE_OQ>(y, zero)
                    & _mm512_cmp_ps_mask::<_CMP_LT_OQ>(x, x_limit)
                    & _mm512_cmp_ps_mask::<_CMP_LT_OQ>(y, y_limit);
                if is_inside != u16::MAX {
                    return OUTSIDE;
                }
                let steps = _mm512_set1_ps(STEPS as f32);
                let x = _mm512_cvttps_epi32(_mm512_mul_ps(x, steps));
                let y = _mm512_cvttps_epi32(_mm512_mul_ps(y, steps));
                let index = _mm512_add_epi32(
                    _mm512_mullo_epi32(
                        _mm512_srli_epi32::<6>(y),
                        _mm512_set1_epi32(source.width as i32),
                    ),
                    _mm512_srli_epi32::<6>(x),
                );
                let words = _mm512_i32gather_epi32::<4>(index, source.words.as_ptr().cast());
                let mask = _mm512_set1_epi32(STEPS - 1);
                let (u, v) = (_mm512_and_si512(x, mask), _mm512_and_si512(y, mask));
                let all = _mm512_set1_epi32(STEPS);
                // Bytes (64 − u, u, 64 − u, u).
                let u = _mm512_or_si512(_mm512_sub_epi32(all, u), _mm512_slli_epi32::<8>(u));
                let u = _mm512_or_si512(u, _mm512_slli_epi32::<16>(u));
                // Shorts (64 − v, v).
                let v = _mm512_or_si512(_mm512_sub_epi32(all, v), _mm512_slli_epi32::<16>(v));
                let rows = _mm512_maddubs_epi16(words, u);
                let level = _mm512_srli_epi32::<8>(_mm512_madd_epi16(rows, v));
                let level = _mm512_sub_ps(_mm512_cvtepi32_ps(level), _mm512_set1_ps(MIDDLE));
                let weights = _mm512_loadu_ps(patch.weights[half].as_ptr());
                let centred = _mm512_loadu_ps(patch.centred[half].as_ptr());
                let weighted = _mm512_mul_ps(weights, level);
                sums[0] = _mm512_add_ps(sums[0], weighted);
                sums[1] = _mm512_add_ps(sums[1], _mm512_mul_ps(weighted, level));
                sums[2] = _mm512_add_ps(sums[2], _mm512_mul_ps(centred, level));
            }
            cost_of(reduced(sums[0]), reduced(sums[1]), reduced(sums[2]), patch)
        }
    }
}

/// The sum of the lanes: halves are added until one is left.
#[inline(always)]
unsafe fn reduced(lanes: __m512) -> f32 {
    // SAFETY: the caller has detected the instruction set.
    unsafe {
        let upper = _mm512_shuffle_f32x4::<0b1110>(lanes, lanes);
        let eight = _mm256_add_ps(_mm512_castps512_ps256(lanes), _mm512_castps512_ps256(upper));
        super::avx2::reduced_eight(eight)
    }
}
