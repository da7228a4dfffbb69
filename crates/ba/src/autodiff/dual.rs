//! Dual numbers.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// Number of derivatives of a [`Dual`]: one AVX2 register.
pub const DIRECTIONS: usize = 4;

/// A number with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual {
    /// The value.
    pub re: f64,
    /// Its derivatives.
    pub eps: [f64; DIRECTIONS],
}

/// Number types of a residual: `f64`, or [`Dual`].
pub trait Scalar:
    Copy
    + Debug
    + PartialEq
    + From<f64>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
    + Div<f64, Output = Self>
{
    /// The value without derivatives, for comparisons.
    fn value(self) -> f64;
    /// Chain rule: f(x), given the value f and the slope f' at x.
    fn chain(self, value: f64, slope: f64) -> Self;

    /// Square root.
    fn sqrt(self) -> Self {
        let root = self.value().sqrt();
        self.chain(root, 0.5 / root)
    }
    /// Sine.
    fn sin(self) -> Self {
        let (sin, cos) = self.value().sin_cos();
        self.chain(sin, cos)
    }
    /// Cosine.
    fn cos(self) -> Self {
        let (sin, cos) = self.value().sin_cos();
        self.chain(cos, -sin)
    }
    /// Arc tangent.
    fn atan(self) -> Self {
        let x = self.value();
        self.chain(x.atan(), 1.0 / (1.0 + x * x))
    }
    /// Angle of the vector (`x`, self) from the first axis, in all four quadrants.
    fn atan2(self, x: Self) -> Self {
        let (y, x0) = (self.value(), x.value());
        // The derivatives are those of (y dx₀ − x dy₀) / |(x, y)|², whose value part is zero.
        (self * x0 - x * y) / (x0 * x0 + y * y) + y.atan2(x0)
    }
    /// Exponential.
    fn exp(self) -> Self {
        let exp = self.value().exp();
        self.chain(exp, exp)
    }
    /// Natural logarithm.
    fn ln(self) -> Self {
        self.chain(self.value().ln(), 1.0 / self.value())
    }
    /// Absolute value.
    fn abs(self) -> Self {
        self.chain(self.value().abs(), self.value().signum())
    }
    /// Integer power.
    fn powi(self, n: i32) -> Self {
        self.chain(self.value().powi(n), f64::from(n) * self.value().powi(n - 1))
    }
    /// Real power of a positive number.
    fn powf(self, n: f64) -> Self {
        self.chain(self.value().powf(n), n * self.value().powf(n - 1.0))
    }
}

impl Scalar for f64 {
    #[inline]
    fn value(self) -> f64 {
        self
    }
    #[inline]
    fn chain(self, value: f64, _: f64) -> Self {
        value
    }
}

impl Scalar for Dual {
    #[inline]
    fn value(self) -> f64 {
        self.re
    }
    #[inline]
    fn chain(self, value: f64, slope: f64) -> Self {
        Self { re: value, eps: self.eps.map(|eps| eps * slope) }
    }
}

impl From<f64> for Dual {
    #[inline]
    fn from(re: f64) -> Self {
        Self { re, eps: [0.0; DIRECTIONS] }
    }
}

#[inline(always)]
fn zip(a: &Dual, b: &Dual, f: impl Fn(f64, f64) -> f64) -> [f64; DIRECTIONS] {
    std::array::from_fn(|i| f(a.eps[i], b.eps[i]))
}

impl Add for Dual {
    type Output = Self;
    #[inline]
    fn add(self, b: Self) -> Self {
        Self { re: self.re + b.re, eps: zip(&self, &b, |x, y| x + y) }
    }
}
impl Sub for Dual {
    type Output = Self;
    #[inline]
    fn sub(self, b: Self) -> Self {
        Self { re: self.re - b.re, eps: zip(&self, &b, |x, y| x - y) }
    }
}
impl Mul for Dual {
    type Output = Self;
    #[inline]
    #[expect(clippy::suspicious_arithmetic_impl, reason = "the product rule has a sum")]
    fn mul(self, b: Self) -> Self {
        Self { re: self.re * b.re, eps: zip(&self, &b, |x, y| x * b.re + y * self.re) }
    }
}
impl Div for Dual {
    type Output = Self;
    #[inline]
    fn div(self, b: Self) -> Self {
        let inverse = 1.0 / b.re;
        // Divides instead of multiplying by the inverse, so that the value has the same bits as
        // without derivatives.
        let re = self.re / b.re;
        Self { re, eps: zip(&self, &b, |x, y| (x - y * re) * inverse) }
    }
}
impl Neg for Dual {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        Self { re: -self.re, eps: self.eps.map(|eps| -eps) }
    }
}
impl AddAssign for Dual {
    #[inline]
    fn add_assign(&mut self, b: Self) {
        *self = *self + b;
    }
}
impl SubAssign for Dual {
    #[inline]
    fn sub_assign(&mut self, b: Self) {
        *self = *self - b;
    }
}
impl Add<f64> for Dual {
    type Output = Self;
    #[inline]
    fn add(self, b: f64) -> Self {
        Self { re: self.re + b, ..self }
    }
}
impl Sub<f64> for Dual {
    type Output = Self;
    #[inline]
    fn sub(self, b: f64) -> Self {
        Self { re: self.re - b, ..self }
    }
}
impl Mul<f64> for Dual {
    type Output = Self;
    #[inline]
    fn mul(self, b: f64) -> Self {
        Self { re: self.re * b, eps: self.eps.map(|eps| eps * b) }
    }
}
impl Div<f64> for Dual {
    type Output = Self;
    #[inline]
    fn div(self, b: f64) -> Self {
        Self { re: self.re / b, eps: self.eps.map(|eps| eps / b) }
    }
}
