//! The vector operations of an instruction set.

/// Number of lanes of a vector, for every instruction set.
pub(crate) const LANES: usize = 16;

/// A computation that is generic over the instruction set. `run` and all performance-critical
/// functions that it calls must be `#[inline(always)]`.
pub(crate) trait Task {
    /// Result type.
    type Output;
    /// Runs the computation.
    fn run<S: Simd>(self) -> Self::Output;
}

/// Operations on a vector of sixteen `f32`. Methods without pointers are safe although the CPU may
/// not support their instructions: each implementation is private to its file, and only the `enter`
/// function of the file passes it on, as the type parameter of a [`Task`].
pub(crate) trait Simd: Copy {
    /// The vector.
    type F: Copy;
    /// Number of vectors per iteration of the convolution along columns, limited by the number of
    /// registers.
    const UNROLL: usize;

    /// All lanes have the value `x`.
    fn splat(x: f32) -> Self::F;
    /// Loads sixteen values.
    ///
    /// # Safety
    /// `p` must be valid for reading sixteen `f32`.
    unsafe fn load(p: *const f32) -> Self::F;
    /// Loads sixteen bytes and converts them to `f32`.
    ///
    /// # Safety
    /// `p` must be valid for reading sixteen `u8`.
    unsafe fn load_u8(p: *const u8) -> Self::F;
    /// Stores sixteen values.
    ///
    /// # Safety
    /// `p` must be valid for writing sixteen `f32`.
    unsafe fn store(p: *mut f32, v: Self::F);
    /// Stores sixteen values with non-temporal stores, if the CPU has them. [`fence`](Self::fence)
    /// must follow.
    ///
    /// # Safety
    /// As [`store`](Self::store), and `p` must be a multiple of 64 bytes.
    unsafe fn stream(p: *mut f32, v: Self::F);
    /// Orders the writes of [`stream`](Self::stream) before later writes.
    fn fence();
    /// Truncates to `i32` and stores sixteen values.
    ///
    /// # Safety
    /// `p` must be valid for writing sixteen `i32`, and the values must be in the range of `i32`.
    unsafe fn store_int(p: *mut i32, v: Self::F);
    /// The sixteen values from index `OFFSET` of the concatenation of `low` and `high`. They are
    /// also at `p`.
    ///
    /// # Safety
    /// As [`load`](Self::load); the values at `p` must be those of the concatenation.
    unsafe fn load_between<const OFFSET: i32>(
        p: *const f32,
        low: Self::F,
        high: Self::F,
    ) -> Self::F;
    /// Prefetches the cache line at `p`, which may be any address.
    fn prefetch(p: *const f32);
    /// a + b
    fn add(a: Self::F, b: Self::F) -> Self::F;
    /// a − b
    fn sub(a: Self::F, b: Self::F) -> Self::F;
    /// a · b
    fn mul(a: Self::F, b: Self::F) -> Self::F;
    /// a / b
    fn div(a: Self::F, b: Self::F) -> Self::F;
    /// a · b + c, rounded once.
    fn mul_add(a: Self::F, b: Self::F, c: Self::F) -> Self::F;
    /// Minimum.
    fn min(a: Self::F, b: Self::F) -> Self::F;
    /// Maximum.
    fn max(a: Self::F, b: Self::F) -> Self::F;
    /// √a
    fn sqrt(a: Self::F) -> Self::F;
    /// |a|
    fn abs(a: Self::F) -> Self::F;
    /// ⌊a⌋
    fn floor(a: Self::F) -> Self::F;
    /// `x` where a < b, else `y`.
    fn select_lt(a: Self::F, b: Self::F, x: Self::F, y: Self::F) -> Self::F;
    /// One bit per lane: a < b.
    fn mask_lt(a: Self::F, b: Self::F) -> u32;
    /// `lo` in the lower eight lanes, `hi` in the upper eight.
    fn halves(lo: f32, hi: f32) -> Self::F;
}
