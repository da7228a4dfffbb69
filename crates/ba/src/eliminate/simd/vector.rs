//! Some numbers at once, and what the inner loops do with them.

/// Numbers of a [`Isa::Narrow`] vector: all rows are padded to multiples of it.
pub(crate) const LANES: usize = 4;
/// Numbers of a [`Isa::Wide`] vector.
pub(crate) const WIDE: usize = 8;

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
pub(crate) trait Task {
    fn run<I: Isa>(self);
}

/// How to work on numbers. Functions are safe although their instructions may not exist on the
/// machine: the types that implement this are private to `simd`, and other code gets one from
/// [`dispatch`](super::dispatch) alone, as a type parameter, once its instructions have been found.
/// Products `a·b + c` are fused where the machine can, so that results differ in the last bits
/// between machines with and without, and not otherwise: the order of operations is the same for
/// all widths.
pub(crate) trait Isa: Sized {
    /// [`LANES`] numbers.
    type Narrow: Vector;
    /// [`WIDE`] numbers.
    type Wide: Vector;
    /// Whether there are 32 vector registers and not 16.
    const MANY_REGISTERS: bool;
    /// a b + c for single numbers.
    fn mul_add_one(a: f64, b: f64, c: f64) -> f64;
    /// Runs what was compiled for these instructions, as a function of its own: one of all loops in
    /// one would take the compiler minutes.
    fn run<T: Task>(task: T);
}

#[inline(always)]
pub(super) fn first<T, const N: usize>(slice: &[T]) -> &[T; N] {
    slice.first_chunk().expect("at least one vector")
}

#[inline(always)]
pub(super) fn first_mut<T, const N: usize>(slice: &mut [T]) -> &mut [T; N] {
    slice.first_chunk_mut().expect("at least one vector")
}
