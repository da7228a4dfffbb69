//! Sixteen lanes of `f32`, on whatever the machine has.
//!
//! Every kernel of this crate is written once, generic over [`Simd`], and compiled once per instruction set:
//! [`dispatch`] enters a function with the right target features, into which everything marked
//! `#[inline(always)]` is inlined. A lane computes exactly the same IEEE operations on each instruction set (a
//! multiply-add is fused everywhere or not written as one), and nothing is ever reduced across lanes in an order
//! that depends on the machine, so the results have the same bits everywhere.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod portable;

/// Lanes in a vector, on every instruction set.
pub(crate) const LANES: usize = 16;

/// An instruction set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Isa {
    /// 512-bit vectors.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// 256-bit vectors with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// Plain Rust.
    Portable,
}

impl Isa {
    /// What this machine can run, best first.
    pub(crate) fn available() -> Vec<Isa> {
        let mut sets = Vec::new();
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
            {
                sets.push(Isa::Avx512);
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                sets.push(Isa::Avx2);
            }
        }
        sets.push(Isa::Portable);
        sets
    }

    /// The best one.
    pub(crate) fn best() -> Isa {
        Isa::available()[0]
    }
}

/// Work that is written once for all instruction sets. `run` must be `#[inline(always)]`, and so must everything
/// hot that it calls.
pub(crate) trait Task {
    /// What comes out.
    type Output;
    /// Does it.
    fn run<S: Simd>(self) -> Self::Output;
}

/// Runs `task` compiled for `isa`.
pub(crate) fn dispatch<T: Task>(isa: Isa, task: T) -> T::Output {
    match isa {
        // SAFETY: an `Isa` other than `Portable` is only ever made by `Isa::available`, after detection.
        #[cfg(target_arch = "x86_64")]
        Isa::Avx512 => unsafe { avx512::enter(task) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Isa::Avx2 => unsafe { avx2::enter(task) },
        Isa::Portable => task.run::<portable::Portable>(),
    }
}

/// Operations on a vector of sixteen `f32`. Implementations are zero-sized tokens; the methods are only called from
/// a [`Task`] that was entered through [`dispatch`], which is what makes their intrinsics available.
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
    /// Writes sixteen values past the caches where the machine can; to be followed by [`fence`](Self::fence).
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
    /// Reads sixteen values at `p`, which lie `OFFSET` values into those of `low` and `high` one after the other.
    ///
    /// # Safety
    /// As [`load`](Self::load); the values at `p` are those in the registers.
    unsafe fn load_between<const OFFSET: i32>(p: *const f32, low: Self::F, high: Self::F) -> Self::F;
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
