//! Portable Rust, for CPUs without AVX2, and the reference for the tests of the other instruction
//! sets.

use super::lanes::{LANES, Simd, Task};

/// Type parameter of [`Task::run`]. Only [`enter`] uses it.
#[derive(Clone, Copy)]
struct Portable;

/// Runs `task`.
pub(super) fn enter<T: Task>(task: T) -> T::Output {
    task.run::<Portable>()
}

#[inline(always)]
fn map2(a: [f32; LANES], b: [f32; LANES], f: impl Fn(f32, f32) -> f32) -> [f32; LANES] {
    std::array::from_fn(|i| f(a[i], b[i]))
}

impl Simd for Portable {
    type F = [f32; LANES];
    const UNROLL: usize = 1;

    #[inline(always)]
    fn splat(x: f32) -> Self::F {
        [x; LANES]
    }
    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self::F {
        // SAFETY: guaranteed by the caller; unaligned is allowed.
        unsafe { p.cast::<Self::F>().read_unaligned() }
    }
    #[inline(always)]
    unsafe fn load_u8(p: *const u8) -> Self::F {
        // SAFETY: guaranteed by the caller; bytes have no alignment.
        let bytes = unsafe { p.cast::<[u8; LANES]>().read() };
        bytes.map(f32::from)
    }
    #[inline(always)]
    unsafe fn store(p: *mut f32, v: Self::F) {
        // SAFETY: guaranteed by the caller; unaligned is allowed.
        unsafe { p.cast::<Self::F>().write_unaligned(v) }
    }
    #[inline(always)]
    unsafe fn stream(p: *mut f32, v: Self::F) {
        // SAFETY: guaranteed by the caller.
        unsafe { Self::store(p, v) };
    }
    #[inline(always)]
    fn fence() {}
    #[inline(always)]
    unsafe fn store_int(p: *mut i32, v: Self::F) {
        // SAFETY: guaranteed by the caller.
        unsafe { p.cast::<[i32; LANES]>().write_unaligned(v.map(|v| v.to_int_unchecked())) }
    }
    #[inline(always)]
    unsafe fn load_between<const OFFSET: i32>(p: *const f32, _: Self::F, _: Self::F) -> Self::F {
        // SAFETY: guaranteed by the caller.
        unsafe { Self::load(p) }
    }
    #[inline(always)]
    fn prefetch(_: *const f32) {}
    #[inline(always)]
    fn add(a: Self::F, b: Self::F) -> Self::F {
        map2(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(a: Self::F, b: Self::F) -> Self::F {
        map2(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(a: Self::F, b: Self::F) -> Self::F {
        map2(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn div(a: Self::F, b: Self::F) -> Self::F {
        map2(a, b, |a, b| a / b)
    }
    #[inline(always)]
    fn mul_add(a: Self::F, b: Self::F, c: Self::F) -> Self::F {
        std::array::from_fn(|i| a[i].mul_add(b[i], c[i]))
    }
    #[inline(always)]
    fn min(a: Self::F, b: Self::F) -> Self::F {
        map2(a, b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(a: Self::F, b: Self::F) -> Self::F {
        map2(a, b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn sqrt(a: Self::F) -> Self::F {
        a.map(f32::sqrt)
    }
    #[inline(always)]
    fn abs(a: Self::F) -> Self::F {
        a.map(f32::abs)
    }
    #[inline(always)]
    fn floor(a: Self::F) -> Self::F {
        a.map(f32::floor)
    }
    #[inline(always)]
    fn select_lt(a: Self::F, b: Self::F, x: Self::F, y: Self::F) -> Self::F {
        std::array::from_fn(|i| if a[i] < b[i] { x[i] } else { y[i] })
    }
    #[inline(always)]
    fn mask_lt(a: Self::F, b: Self::F) -> u32 {
        let mut mask = 0;
        for i in 0..LANES {
            mask |= u32::from(a[i] < b[i]) << i;
        }
        mask
    }
    #[inline(always)]
    fn halves(lo: f32, hi: f32) -> Self::F {
        std::array::from_fn(|i| if i < LANES / 2 { lo } else { hi })
    }
}
