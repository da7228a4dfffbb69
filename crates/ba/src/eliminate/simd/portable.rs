//! Plain Rust, for processors without the other instruction sets.

use super::vector::{Isa, Kernel, LANES, Vector, WIDE, first, first_mut};

/// The baseline of the target.
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
    fn run<T: Kernel>(kernel: T) {
        kernel.run::<Self>();
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
