//! What kernels ask of an instruction set.

/// Lanes in a vector, on every instruction set.
pub(crate) const LANES: usize = 16;

/// Work that is written once for all instruction sets. `run` must be `#[inline(always)]`, and so
/// must everything hot that it calls.
pub(crate) trait Task {
    /// What comes out.
    type Output;
    /// Does it.
    fn run<S: Simd>(self) -> Self::Output;
}

/// Operations on a vector of sixteen `f32`. Methods without a pointer are safe although their
/// instructions may not exist on the machine: each implementation is private to its file, and other
/// code gets it from that file's `enter` alone, as the type parameter of a [`Task`].
pub(crate) trait Simd: Copy {
    /// The vector.
    type F: Copy;
    /// How many vectors a convolution keeps in flight beside each other: what fills the registers.
    const BESIDE: usize;

    /// All lanes equal.
    fn splat(x: f32) -> Self::F;
    /// Reads sixteen values.
    ///
    /// # Safety
    /// `p` must be valid for reading sixteen `f32`.
    unsafe fn load(p: *const f32) -> Self::F;
    /// Reads sixteen bytes as numbers.
    ///
    /// # Safety
    /// `p` must be valid for reading sixteen `u8`.
    unsafe fn load_u8(p: *const u8) -> Self::F;
    /// Writes sixteen values.
    ///
    /// # Safety
    /// `p` must be valid for writing sixteen `f32`.
    unsafe fn store(p: *mut f32, v: Self::F);
    /// Writes sixteen values past the caches where the machine can; to be followed by
    /// [`fence`](Self::fence).
    ///
    /// # Safety
    /// As [`store`](Self::store), and `p` must be a multiple of 64 bytes.
    unsafe fn stream(p: *mut f32, v: Self::F);
    /// Orders the writes of [`stream`](Self::stream) before whatever other threads are told later.
    fn fence();
    /// Writes sixteen whole numbers.
    ///
    /// # Safety
    /// `p` must be valid for writing sixteen `i32`, the values within their range.
    unsafe fn store_int(p: *mut i32, v: Self::F);
    /// Reads sixteen values at `p`, which lie `OFFSET` values into those of `low` and `high` one
    /// after the other.
    ///
    /// # Safety
    /// As [`load`](Self::load); the values at `p` are those in the registers.
    unsafe fn load_between<const OFFSET: i32>(
        p: *const f32,
        low: Self::F,
        high: Self::F,
    ) -> Self::F;
    /// Asks for the cache line at `p`, which may be any address.
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
    /// The smaller one.
    fn min(a: Self::F, b: Self::F) -> Self::F;
    /// The larger one.
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
