//! AVX2 with fused multiply-add: two registers per vector.

use super::lanes::{Simd, Task};
use std::arch::x86_64::*;

/// Type parameter of [`Task::run`]. Only [`enter`] uses it.
#[derive(Clone, Copy)]
struct Avx2;

/// Runs `task` in a function that is compiled for AVX2.
#[target_feature(enable = "avx2,fma")]
pub(super) fn enter<T: Task>(task: T) -> T::Output {
    task.run::<Avx2>()
}

// SAFETY of every block below: these methods are only inlined into `enter`, whose callers have
// detected the instruction set; the caller guarantees that pointers are valid, and no load or store
// except `stream` needs alignment.
impl Simd for Avx2 {
    type F = [__m256; 2];
    const UNROLL: usize = 1;

    #[inline(always)]
    fn splat(x: f32) -> Self::F {
        // SAFETY: see above.
        unsafe { [_mm256_set1_ps(x); 2] }
    }
    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self::F {
        // SAFETY: see above.
        unsafe { [_mm256_loadu_ps(p), _mm256_loadu_ps(p.add(8))] }
    }
    #[inline(always)]
    unsafe fn load_u8(p: *const u8) -> Self::F {
        // SAFETY: see above.
        unsafe {
            let bytes = _mm_loadu_si128(p.cast());
            let upper = _mm_unpackhi_epi64(bytes, bytes);
            [
                _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(bytes)),
                _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(upper)),
            ]
        }
    }
    #[inline(always)]
    unsafe fn store(p: *mut f32, v: Self::F) {
        // SAFETY: see above.
        unsafe {
            _mm256_storeu_ps(p, v[0]);
            _mm256_storeu_ps(p.add(8), v[1]);
        }
    }
    #[inline(always)]
    unsafe fn stream(p: *mut f32, v: Self::F) {
        // SAFETY: see above; the caller guarantees alignment.
        unsafe {
            _mm256_stream_ps(p, v[0]);
            _mm256_stream_ps(p.add(8), v[1]);
        }
    }
    #[inline(always)]
    fn fence() {
        // SAFETY: SSE is part of x86-64.
        unsafe { _mm_sfence() }
    }
    #[inline(always)]
    unsafe fn store_int(p: *mut i32, v: Self::F) {
        // SAFETY: see above.
        unsafe {
            _mm256_storeu_si256(p.cast(), _mm256_cvttps_epi32(v[0]));
            _mm256_storeu_si256(p.add(8).cast(), _mm256_cvttps_epi32(v[1]));
        }
    }
    #[inline(always)]
    unsafe fn load_between<const OFFSET: i32>(p: *const f32, _: Self::F, _: Self::F) -> Self::F {
        // A combination of registers would need two shuffles.
        // SAFETY: see above.
        unsafe { Self::load(p) }
    }
    #[inline(always)]
    fn prefetch(p: *const f32) {
        // SAFETY: a prefetch has no effect on results.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(p.cast()) }
    }
    #[inline(always)]
    fn add(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see above.
        unsafe { [_mm256_add_ps(a[0], b[0]), _mm256_add_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn sub(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see above.
        unsafe { [_mm256_sub_ps(a[0], b[0]), _mm256_sub_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn mul(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see above.
        unsafe { [_mm256_mul_ps(a[0], b[0]), _mm256_mul_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn div(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see above.
        unsafe { [_mm256_div_ps(a[0], b[0]), _mm256_div_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn min(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see above.
        unsafe { [_mm256_min_ps(a[0], b[0]), _mm256_min_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn max(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: see above.
        unsafe { [_mm256_max_ps(a[0], b[0]), _mm256_max_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn mul_add(a: Self::F, b: Self::F, c: Self::F) -> Self::F {
        // SAFETY: see above.
        unsafe { [_mm256_fmadd_ps(a[0], b[0], c[0]), _mm256_fmadd_ps(a[1], b[1], c[1])] }
    }
    #[inline(always)]
    fn sqrt(a: Self::F) -> Self::F {
        // SAFETY: see above.
        unsafe { [_mm256_sqrt_ps(a[0]), _mm256_sqrt_ps(a[1])] }
    }
    #[inline(always)]
    fn abs(a: Self::F) -> Self::F {
        // SAFETY: see above.
        unsafe {
            let sign = _mm256_set1_ps(-0.0);
            [_mm256_andnot_ps(sign, a[0]), _mm256_andnot_ps(sign, a[1])]
        }
    }
    #[inline(always)]
    fn floor(a: Self::F) -> Self::F {
        // SAFETY: see above.
        unsafe { [_mm256_floor_ps(a[0]), _mm256_floor_ps(a[1])] }
    }
    #[inline(always)]
    fn select_lt(a: Self::F, b: Self::F, x: Self::F, y: Self::F) -> Self::F {
        // SAFETY: see above.
        unsafe {
            [
                _mm256_blendv_ps(y[0], x[0], _mm256_cmp_ps::<_CMP_LT_OQ>(a[0], b[0])),
                _mm256_blendv_ps(y[1], x[1], _mm256_cmp_ps::<_CMP_LT_OQ>(a[1], b[1])),
            ]
        }
    }
    #[inline(always)]
    fn mask_lt(a: Self::F, b: Self::F) -> u32 {
        // SAFETY: see above.
        unsafe {
            let lo = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(a[0], b[0])) as u32;
            let hi = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(a[1], b[1])) as u32;
            lo | hi << 8
        }
    }
    #[inline(always)]
    fn halves(lo: f32, hi: f32) -> Self::F {
        // SAFETY: see above.
        unsafe { [_mm256_set1_ps(lo), _mm256_set1_ps(hi)] }
    }
}
