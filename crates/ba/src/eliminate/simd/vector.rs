//! Traits of vectors, instruction sets and kernels.

/// Length of an [`Isa::Narrow`] vector. All rows are padded to multiples of it.
pub(crate) const LANES: usize = 4;
/// Length of an [`Isa::Wide`] vector.
pub(crate) const WIDE: usize = 8;

/// A vector of numbers. Loads and stores use the first numbers of a slice.
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

/// A storage type: double or single precision.
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

/// Code that is compiled for an instruction set: all that `run` calls has to be inlined.
pub(crate) trait Kernel {
    fn run<I: Isa>(self);
}

/// An instruction set. Its functions are safe although their instructions may be missing on the
/// processor: the types that implement this trait are private to `simd`, and other code gets one
/// only from [`dispatch`](super::dispatch), as a type parameter, after the instructions were
/// detected. Products `a·b + c` are fused if the processor can. Results therefore differ in the
/// last bits between processors with and without fused multiply-add, and nowhere else: the order of
/// operations is the same for all widths.
pub(crate) trait Isa: Sized {
    /// [`LANES`] numbers.
    type Narrow: Vector;
    /// [`WIDE`] numbers.
    type Wide: Vector;
    /// Whether there are 32 vector registers instead of 16.
    const MANY_REGISTERS: bool;
    /// a b + c for single numbers.
    fn mul_add_one(a: f64, b: f64, c: f64) -> f64;
    /// Runs a kernel as a function that is compiled for these instructions. One function for all
    /// loops together would take minutes to compile.
    fn run<T: Kernel>(kernel: T);
}

#[inline(always)]
pub(super) fn first<T, const N: usize>(slice: &[T]) -> &[T; N] {
    slice.first_chunk().expect("at least one vector")
}

#[inline(always)]
pub(super) fn first_mut<T, const N: usize>(slice: &mut [T]) -> &mut [T; N] {
    slice.first_chunk_mut().expect("at least one vector")
}
