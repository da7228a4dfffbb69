//! Tests of the root finder, with a reference implementation: the roots of the derivative split the
//! line into monotone intervals of at most one root each, recursively (Yuksel 2022,
//! "High-performance polynomial root finding for graphics").

use super::*;
use crate::Rng;

const TERMS: usize = DEGREE + 1;

/// The reference implementation. Roots in [−1, 1] come from the polynomial and the others from the
/// reversed polynomial, so that powers stay bounded. Double roots, which do not change the sign,
/// are not found.
fn reference_roots(coefficients: &Polynomial) -> ArrayVec<f64, DEGREE> {
    let mut roots = roots_in_unit_interval(coefficients);
    let mut reversed = *coefficients;
    reversed.reverse();
    for inverse in roots_in_unit_interval(&reversed) {
        if inverse != 0.0 && inverse.abs() < 1.0 && !roots.is_full() {
            roots.push(1.0 / inverse);
        }
    }
    roots
}

fn roots_in_unit_interval(coefficients: &[f64; TERMS]) -> ArrayVec<f64, DEGREE> {
    // derivatives[k] = p⁽ᵏ⁾/k!, whose coefficients are binomial multiples.
    let mut derivatives = [[0.0; TERMS]; TERMS];
    derivatives[0] = *coefficients;
    for k in 1..TERMS {
        for i in 0..TERMS - k {
            derivatives[k][i] = derivatives[k - 1][i + 1] * ((i + 1) as f64 / k as f64);
        }
    }
    let mut roots = ArrayVec::<f64, DEGREE>::new();
    for k in (0..TERMS - 1).rev() {
        let terms = TERMS - k;
        let (p, dp) = (&derivatives[k][..terms], &derivatives[k + 1][..terms - 1]);
        let mut found = ArrayVec::<f64, DEGREE>::new();
        let mut low = -1.0;
        let mut value_at_low = horner(p, low);
        for high in roots.iter().copied().chain([1.0]) {
            let value_at_high = horner(p, high);
            if (value_at_low < 0.0) != (value_at_high < 0.0) && !found.is_full() {
                found.push(monotone_root(p, dp, (k + 1) as f64, low, high, value_at_low < 0.0));
            }
            (low, value_at_low) = (high, value_at_high);
        }
        roots = found;
    }
    roots
}

fn horner(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// Maximum number of steps: bisection reduces a bracket of length 2 to rounding in 53.
const MAX_BRACKET_STEPS: usize = 60;

/// The root of `p` between `low` and `high` by Newton's method, with bisection if a step leaves the
/// bracket. `p` increases through zero if `rises`. The derivative of `p` is `factor · dp`.
fn monotone_root(
    p: &[f64],
    dp: &[f64],
    factor: f64,
    mut low: f64,
    mut high: f64,
    rises: bool,
) -> f64 {
    let mut x = 0.5 * (low + high);
    for _ in 0..MAX_BRACKET_STEPS {
        let value = horner(p, x);
        if (value < 0.0) == rises {
            low = x;
        } else {
            high = x;
        }
        let newton = x - value / (factor * horner(dp, x));
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - x).abs() <= f64::EPSILON * x.abs() {
            return next;
        }
        x = next;
    }
    x
}

/// Polynomials of known roots, which are well separated and so well conditioned.
#[test]
fn recovers_known_roots() {
    let mut rng = Rng::stream(1, &[]);
    for _ in 0..2000 {
        let mut expected: Vec<f64> =
            (0..2 * rng.below(4)).map(|_| (rng.normal() * 1.5).sinh()).collect();
        expected.sort_by(f64::total_cmp);
        if expected.windows(2).any(|pair| pair[1] - pair[0] < 0.1 * (1.0 + pair[0].abs())) {
            continue;
        }
        let mut p = [0.0; TERMS];
        p[0] = 1.0;
        for root in &expected {
            for i in (0..TERMS).rev() {
                p[i] = if i > 0 { p[i - 1] } else { 0.0 } - root * p[i];
            }
        }
        // Pairs of complex roots complete the degree: x² + ax + 1 with |a| < 2.
        for _ in 0..(10 - expected.len()) / 2 {
            let a = 3.0 * rng.uniform() - 1.5;
            for i in (0..TERMS).rev() {
                p[i] += if i > 0 { a * p[i - 1] } else { 0.0 } + if i > 1 { p[i - 2] } else { 0.0 };
            }
        }
        let mut found = real_roots(&p);
        found.sort_by(f64::total_cmp);
        assert_eq!(found.len(), expected.len(), "{expected:?} {found:?}");
        for (found, expected) in found.iter().zip(&expected) {
            assert!(
                (found - expected).abs() < 1e-6 * (1.0 + expected.abs()),
                "{expected:?} {found:?}"
            );
        }
    }
}

/// Polynomials of random coefficients.
#[test]
fn agrees_with_the_reference() {
    let mut rng = Rng::stream(3, &[]);
    let mut different = 0;
    for _ in 0..20_000 {
        let p: Polynomial = std::array::from_fn(|_| rng.normal() * (2.0 * rng.normal()).exp());
        let (mut found, mut expected) = (real_roots(&p), reference_roots(&p));
        found.sort_by(f64::total_cmp);
        expected.sort_by(f64::total_cmp);
        let near = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-6 * (1.0 + a.abs());
        different +=
            usize::from(found.len() != expected.len() || !found.iter().zip(&expected).all(near));
    }
    // The two differ in nearly double roots, and rounding makes Sturm chains miss a few roots.
    assert!(different <= 20, "{different} of 20000");
}
