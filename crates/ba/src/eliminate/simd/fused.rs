//! Vector instructions of x86-64.

use std::arch::x86_64::{
    __m256d, __m512d, _mm_loadu_ps, _mm_storeu_ps, _mm256_cvtpd_ps, _mm256_cvtps_pd,
    _mm256_fmadd_pd, _mm256_fnmadd_pd, _mm256_loadu_pd, _mm256_loadu_ps, _mm256_mul_pd,
    _mm256_set1_pd, _mm256_storeu_pd, _mm256_storeu_ps, _mm512_cvtpd_ps, _mm512_cvtps_pd,
    _mm512_fmadd_pd, _mm512_fnmadd_pd, _mm512_loadu_pd, _mm512_mul_pd, _mm512_set1_pd,
    _mm512_storeu_pd,
};

use super::vector::{Isa, Kernel, LANES, Vector, WIDE, first, first_mut};

/// AVX2 with fused multiply-add.
pub(super) struct Fused;
impl Isa for Fused {
    type Narrow = Four;
    type Wide = TwoNarrow;
    const MANY_REGISTERS: bool = false;
    #[inline(always)]
    fn mul_add_one(a: f64, b: f64, c: f64) -> f64 {
        a.mul_add(b, c)
    }
    #[inline(always)]
    fn run<T: Kernel>(kernel: T) {
        #[target_feature(enable = "avx2,fma")]
        fn run<T: Kernel>(kernel: T) {
            kernel.run::<Fused>();
        }
        // SAFETY: only `instruction_set` uses this type, for an `Isa` that has the features.
        unsafe { run(kernel) }
    }
}

/// AVX-512 F and VL, and all of [`Fused`].
pub(super) struct Fused512;
impl Isa for Fused512 {
    type Narrow = Four;
    type Wide = Eight;
    const MANY_REGISTERS: bool = true;
    #[inline(always)]
    fn mul_add_one(a: f64, b: f64, c: f64) -> f64 {
        a.mul_add(b, c)
    }
    #[inline(always)]
    fn run<T: Kernel>(kernel: T) {
        #[target_feature(enable = "avx512f,avx512vl,avx2,fma")]
        fn run<T: Kernel>(kernel: T) {
            kernel.run::<Fused512>();
        }
        // SAFETY: only `instruction_set` uses this type, for an `Isa` that has the features.
        unsafe { run(kernel) }
    }
}

macro_rules! vector {
    (
        $name:ident, $inner:ty, $len:ident, $load:ident, $store:ident, $widen:expr, $narrow:expr,
        $splat:ident, $mul:ident, $fma:ident, $fnma:ident
    ) => {
        #[derive(Clone, Copy)]
        pub(super) struct $name($inner);
        // In each of these, the instruction exists wherever the type may be used, and it reads or
        // writes only memory that the reference covers.
        impl Vector for $name {
            #[inline(always)]
            fn load(from: &[f64]) -> Self {
                // SAFETY: as above.
                Self(unsafe { $load(first::<_, $len>(from).as_ptr()) })
            }
            #[inline(always)]
            fn store(self, to: &mut [f64]) {
                // SAFETY: as above.
                unsafe { $store(first_mut::<_, $len>(to).as_mut_ptr(), self.0) }
            }
            #[inline(always)]
            fn load_single(from: &[f32]) -> Self {
                // SAFETY: as above.
                Self(unsafe { $widen(first::<_, $len>(from).as_ptr()) })
            }
            #[inline(always)]
            fn store_single(self, to: &mut [f32]) {
                // SAFETY: as above.
                unsafe { $narrow(first_mut::<_, $len>(to).as_mut_ptr(), self.0) }
            }
            #[inline(always)]
            fn splat(x: f64) -> Self {
                // SAFETY: as above.
                Self(unsafe { $splat(x) })
            }
            #[inline(always)]
            fn mul(self, b: Self) -> Self {
                // SAFETY: as above.
                Self(unsafe { $mul(self.0, b.0) })
            }
            #[inline(always)]
            fn mul_add(self, b: Self, c: Self) -> Self {
                // SAFETY: as above.
                Self(unsafe { $fma(self.0, b.0, c.0) })
            }
            #[inline(always)]
            fn neg_mul_add(self, b: Self, c: Self) -> Self {
                // SAFETY: as above.
                Self(unsafe { $fnma(self.0, b.0, c.0) })
            }
        }
    };
}

vector!(
    Four,
    __m256d,
    LANES,
    _mm256_loadu_pd,
    _mm256_storeu_pd,
    |from| _mm256_cvtps_pd(_mm_loadu_ps(from)),
    |to, numbers| _mm_storeu_ps(to, _mm256_cvtpd_ps(numbers)),
    _mm256_set1_pd,
    _mm256_mul_pd,
    _mm256_fmadd_pd,
    _mm256_fnmadd_pd
);
vector!(
    Eight,
    __m512d,
    WIDE,
    _mm512_loadu_pd,
    _mm512_storeu_pd,
    |from| _mm512_cvtps_pd(_mm256_loadu_ps(from)),
    |to, numbers| _mm256_storeu_ps(to, _mm512_cvtpd_ps(numbers)),
    _mm512_set1_pd,
    _mm512_mul_pd,
    _mm512_fmadd_pd,
    _mm512_fnmadd_pd
);

/// A wide vector as two narrow ones.
#[derive(Clone, Copy)]
pub(super) struct TwoNarrow(Four, Four);
impl Vector for TwoNarrow {
    #[inline(always)]
    fn load(from: &[f64]) -> Self {
        let from = first::<_, WIDE>(from);
        Self(Four::load(&from[..LANES]), Four::load(&from[LANES..]))
    }
    #[inline(always)]
    fn store(self, to: &mut [f64]) {
        let (low, high) = first_mut::<_, WIDE>(to).split_at_mut(LANES);
        self.0.store(low);
        self.1.store(high);
    }
    #[inline(always)]
    fn load_single(from: &[f32]) -> Self {
        let from = first::<_, WIDE>(from);
        Self(Four::load_single(&from[..LANES]), Four::load_single(&from[LANES..]))
    }
    #[inline(always)]
    fn store_single(self, to: &mut [f32]) {
        let (low, high) = first_mut::<_, WIDE>(to).split_at_mut(LANES);
        self.0.store_single(low);
        self.1.store_single(high);
    }
    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self(Four::splat(x), Four::splat(x))
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Self(self.0.mul(b.0), self.1.mul(b.1))
    }
    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        Self(self.0.mul_add(b.0, c.0), self.1.mul_add(b.1, c.1))
    }
    #[inline(always)]
    fn neg_mul_add(self, b: Self, c: Self) -> Self {
        Self(self.0.neg_mul_add(b.0, c.0), self.1.neg_mul_add(b.1, c.1))
    }
}
