//! Four or eight numbers at once, with the machine's instructions for it or without.
//!
//! The vectors are explicit because the compiler, left alone with loops over small arrays, vectorises along the wrong one.

/// Numbers of a [`Isa::Narrow`] vector: all rows are padded to multiples of it.
pub(super) const LANES: usize = 4;
/// Numbers of a [`Isa::Wide`] vector.
pub(super) const WIDE: usize = 8;

/// Some numbers that are handled at once. Loads and stores take the first numbers of a slice.
pub(crate) trait Vector: Copy {
    fn load(from: &[f64]) -> Self;
    fn store(self, to: &mut [f64]);
    /// From single precision.
    fn load_single(from: &[f32]) -> Self;
    /// Rounded to single precision.
    fn store_single(self, to: &mut [f32]);
    fn splat(x: f64) -> Self;
    fn mul(self, b: Self) -> Self;
    /// self · b + c.
    fn mul_add(self, b: Self, c: Self) -> Self;
    /// c − self · b.
    fn neg_mul_add(self, b: Self, c: Self) -> Self;
}

/// In what numbers are stored.
pub(crate) trait Stored: bytemuck::Pod {
    /// As [`Vector::load`].
    fn load<V: Vector>(from: &[Self]) -> V;
    /// As [`Vector::store`].
    fn store<V: Vector>(vector: V, to: &mut [Self]);
    fn number(self) -> f64;
}

impl Stored for f64 {
    #[inline(always)]
    fn load<V: Vector>(from: &[Self]) -> V {
        V::load(from)
    }
    #[inline(always)]
    fn store<V: Vector>(vector: V, to: &mut [Self]) {
        vector.store(to);
    }
    fn number(self) -> f64 {
        self
    }
}

impl Stored for f32 {
    #[inline(always)]
    fn load<V: Vector>(from: &[Self]) -> V {
        V::load_single(from)
    }
    #[inline(always)]
    fn store<V: Vector>(vector: V, to: &mut [Self]) {
        vector.store_single(to);
    }
    fn number(self) -> f64 {
        f64::from(self)
    }
}

/// Work that is compiled for an instruction set: all that `run` calls is to be inlined.
pub(super) trait Task<I> {
    fn run(self);
}

/// How to work on numbers. Products `a·b + c` are fused where the machine can, so that results differ in the last bits between
/// machines with and without, and not otherwise: the order of operations is the same for all widths.
pub(super) trait Isa: Sized {
    /// [`LANES`] numbers.
    type Narrow: Vector;
    /// [`WIDE`] numbers.
    type Wide: Vector;
    /// Whether there are 32 vector registers and not 16.
    const MANY_REGISTERS: bool;
    /// a b + c for single numbers.
    fn mul_add_one(a: f64, b: f64, c: f64) -> f64;
    /// Runs what was compiled for these instructions, as a function of its own: one of all loops in one would take the compiler
    /// minutes.
    fn run<T: Task<Self>>(task: T);
}

/// No instructions in particular.
pub(super) struct Portable;
impl Isa for Portable {
    type Narrow = [f64; LANES];
    type Wide = [f64; WIDE];
    const MANY_REGISTERS: bool = false;
    #[inline(always)]
    fn mul_add_one(a: f64, b: f64, c: f64) -> f64 {
        a * b + c
    }
    #[inline(never)]
    fn run<T: Task<Self>>(task: T) {
        task.run();
    }
}

impl<const N: usize> Vector for [f64; N] {
    #[inline(always)]
    fn load(from: &[f64]) -> Self {
        *first(from)
    }
    #[inline(always)]
    fn store(self, to: &mut [f64]) {
        *first_mut(to) = self;
    }
    #[inline(always)]
    fn load_single(from: &[f32]) -> Self {
        let from: &[f32; N] = first(from);
        std::array::from_fn(|i| f64::from(from[i]))
    }
    #[inline(always)]
    fn store_single(self, to: &mut [f32]) {
        *first_mut::<_, N>(to) = std::array::from_fn(|i| self[i] as f32);
    }
    #[inline(always)]
    fn splat(x: f64) -> Self {
        [x; N]
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        std::array::from_fn(|i| self[i] * b[i])
    }
    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        std::array::from_fn(|i| self[i] * b[i] + c[i])
    }
    #[inline(always)]
    fn neg_mul_add(self, b: Self, c: Self) -> Self {
        std::array::from_fn(|i| c[i] - self[i] * b[i])
    }
}

#[inline(always)]
fn first<T, const N: usize>(slice: &[T]) -> &[T; N] {
    slice.first_chunk().expect("at least one vector")
}

#[inline(always)]
fn first_mut<T, const N: usize>(slice: &mut [T]) -> &mut [T; N] {
    slice.first_chunk_mut().expect("at least one vector")
}

#[cfg(target_arch = "x86_64")]
pub(super) use fused::{Fused, Fused512};

#[cfg(target_arch = "x86_64")]
mod fused {
    use std::arch::x86_64::{
        __m256d, __m512d, _mm_loadu_ps, _mm_storeu_ps, _mm256_cvtpd_ps, _mm256_cvtps_pd, _mm256_fmadd_pd,
        _mm256_fnmadd_pd, _mm256_loadu_pd, _mm256_loadu_ps, _mm256_mul_pd, _mm256_set1_pd, _mm256_storeu_pd,
        _mm256_storeu_ps, _mm512_cvtpd_ps, _mm512_cvtps_pd, _mm512_fmadd_pd, _mm512_fnmadd_pd,
        _mm512_loadu_pd, _mm512_mul_pd, _mm512_set1_pd, _mm512_storeu_pd,
    };

    use super::{Isa, LANES, Task, Vector, WIDE, first, first_mut};

    /// AVX2 with fused multiply-add. To be used inside functions compiled for these only.
    pub(in super::super) struct Fused;
    impl Isa for Fused {
        type Narrow = Four;
        type Wide = Twice;
        const MANY_REGISTERS: bool = false;
        #[inline(always)]
        fn mul_add_one(a: f64, b: f64, c: f64) -> f64 {
            a.mul_add(b, c)
        }
        #[inline(always)]
        fn run<T: Task<Self>>(task: T) {
            #[target_feature(enable = "avx2,fma")]
            fn run<T: Task<Fused>>(task: T) {
                task.run();
            }
            // SAFETY: whoever uses the type has found the features.
            unsafe { run(task) }
        }
    }

    /// AVX-512 F and VL. To be used inside functions compiled for these only.
    pub(in super::super) struct Fused512;
    impl Isa for Fused512 {
        type Narrow = Four;
        type Wide = Eight;
        const MANY_REGISTERS: bool = true;
        #[inline(always)]
        fn mul_add_one(a: f64, b: f64, c: f64) -> f64 {
            a.mul_add(b, c)
        }
        #[inline(always)]
        fn run<T: Task<Self>>(task: T) {
            #[target_feature(enable = "avx512f,avx512vl,avx2,fma")]
            fn run<T: Task<Fused512>>(task: T) {
                task.run();
            }
            // SAFETY: whoever uses the type has found the features.
            unsafe { run(task) }
        }
    }

    macro_rules! vector {
        ($name:ident, $inner:ty, $len:ident, $load:ident, $store:ident, $widen:expr, $narrow:expr, $splat:ident, $mul:ident, $fma:ident, $fnma:ident) => {
            #[derive(Clone, Copy)]
            pub(in super::super) struct $name($inner);
            // In each of these the instruction exists where the type may be used, and reads or writes what the reference covers.
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

    /// Eight numbers where four is what the machine has.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Twice(Four, Four);
    impl Vector for Twice {
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
}
