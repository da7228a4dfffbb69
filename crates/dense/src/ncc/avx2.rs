//! The kernel with AVX2: 8 samples a register.

use std::arch::x86_64::*;

use super::constants::{LANES, MIDDLE, OUTSIDE, STEPS};
use super::kernel::{Ncc, Task, Warp, cost_of};
use super::patch::{DX, DY, Patch};
use super::source::Source;

/// Type parameter of [`Task::run`]. Only [`enter`] uses it.
#[derive(Clone, Copy)]
struct Avx2;

/// Runs `task` in a function that is compiled for AVX2.
#[target_feature(enable = "avx2")]
pub(super) fn enter<T: Task>(task: T) -> T::Output {
    task.run::<Avx2>()
}

impl Ncc for Avx2 {
    #[inline(always)]
    fn cost(source: &Source, warp: &Warp, patch: &Patch) -> f32 {
        // SAFETY: this method is only inlined into `enter`, whose callers have detected the
        // instruction set. Samples are loaded only after their positions were found inside.
        unsafe {
            let [x_limit, y_limit] = source.limits().map(|limit| _mm256_set1_ps(limit));
            let zero = _mm256_setzero_ps();
            // By lower and upper half of the lanes.
            let mut sums = [[zero; 3]; 2];
            for half in 0..2 {
                for (part, sums) in sums.iter_mut().enumerate() {
                    let lane = part * (LANES / 2);
                    let dx = _mm256_loadu_ps(DX[half][lane..].as_ptr());
                    let dy = _mm256_loadu_ps(DY[half][lane..].as_ptr());
                    let at = |axis: usize| {
                        let step = _mm256_add_ps(
                            _mm256_mul_ps(_mm256_set1_ps(warp.dx[axis]), dx),
                            _mm256_mul_ps(_mm256_set1_ps(warp.dy[axis]), dy),
                        );
                        _mm256_add_ps(_mm256_set1_ps(warp.centre[axis]), step)
                    };
                    let z = at(2);
                    let inverse = _mm256_div_ps(_mm256_set1_ps(1.0), z);
                    let (x, y) = (_mm256_mul_ps(at(0), inverse), _mm256_mul_ps(at(1), inverse));
                    let is_inside = [
                        _mm256_cmp_ps::<_CMP_GE_OQ>(x, zero),
                        _mm256_cmp_ps::<_CMP_GE_OQ>(y, zero),
                        _mm256_cmp_ps::<_CMP_LT_OQ>(x, x_limit),
                        _mm256_cmp_ps::<_CMP_LT_OQ>(y, y_limit),
                    ]
                    .into_iter()
                    .fold(_mm256_cmp_ps::<_CMP_GT_OQ>(z, zero), |all, one| _mm256_and_ps(all, one));
                    if _mm256_movemask_ps(is_inside) != 0xff {
                        return OUTSIDE;
                    }
                    let steps = _mm256_set1_ps(STEPS as f32);
                    let x = _mm256_cvttps_epi32(_mm256_mul_ps(x, steps));
                    let y = _mm256_cvttps_epi32(_mm256_mul_ps(y, steps));
                    let index = _mm256_add_epi32(
                        _mm256_mullo_epi32(
                            _mm256_srli_epi32::<6>(y),
                            _mm256_set1_epi32(source.width as i32),
                        ),
                        _mm256_srli_epi32::<6>(x),
                    );
                    let words = _mm256_i32gather_epi32::<4>(source.words.as_ptr().cast(), index);
                    let mask = _mm256_set1_epi32(STEPS - 1);
                    let (u, v) = (_mm256_and_si256(x, mask), _mm256_and_si256(y, mask));
                    let all = _mm256_set1_epi32(STEPS);
                    // Bytes (64 − u, u, 64 − u, u).
                    let u = _mm256_or_si256(_mm256_sub_epi32(all, u), _mm256_slli_epi32::<8>(u));
                    let u = _mm256_or_si256(u, _mm256_slli_epi32::<16>(u));
                    // Shorts (64 − v, v).
                    let v = _mm256_or_si256(_mm256_sub_epi32(all, v), _mm256_slli_epi32::<16>(v));
                    let rows = _mm256_maddubs_epi16(words, u);
                    let level = _mm256_srli_epi32::<8>(_mm256_madd_epi16(rows, v));
                    let level = _mm256_sub_ps(_mm256_cvtepi32_ps(level), _mm256_set1_ps(MIDDLE));
                    let weights = _mm256_loadu_ps(patch.weights[half][lane..].as_ptr());
                    let centred = _mm256_loadu_ps(patch.centred[half][lane..].as_ptr());
                    let weighted = _mm256_mul_ps(weights, level);
                    sums[0] = _mm256_add_ps(sums[0], weighted);
                    sums[1] = _mm256_add_ps(sums[1], _mm256_mul_ps(weighted, level));
                    sums[2] = _mm256_add_ps(sums[2], _mm256_mul_ps(centred, level));
                }
            }
            let sum = reduced_eight(_mm256_add_ps(sums[0][0], sums[1][0]));
            let squares = reduced_eight(_mm256_add_ps(sums[0][1], sums[1][1]));
            let products = reduced_eight(_mm256_add_ps(sums[0][2], sums[1][2]));
            cost_of(sum, squares, products, patch)
        }
    }
}

/// The sum of eight lanes: halves are added until one is left.
#[inline(always)]
pub(super) unsafe fn reduced_eight(lanes: __m256) -> f32 {
    // SAFETY: the caller has detected the instruction set.
    unsafe {
        let four = _mm_add_ps(_mm256_castps256_ps128(lanes), _mm256_extractf128_ps::<1>(lanes));
        let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
        _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps::<1>(two, two)))
    }
}
