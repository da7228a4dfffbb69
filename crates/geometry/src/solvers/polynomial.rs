//! Real roots of polynomials, coefficients in ascending order.

use arrayvec::ArrayVec;

/// Newton steps on a cubic; from the starts chosen below, convergence is monotone and takes about six.
const MAX_CUBIC_STEPS: usize = 50;

/// One real root of x³ + c₂x² + c₁x + c₀, as in Persson and Nordberg 2018 ("Lambda Twist"): Newton's method from a point
/// beyond the stationary points, on the side of the root.
pub(crate) fn cubic_root([c0, c1, c2]: [f64; 3]) -> f64 {
    let value = |x: f64| ((x + c2) * x + c1) * x + c0;
    let slope = |x: f64| (3.0 * x + 2.0 * c2) * x + c1;
    let discriminant = c2 * c2 - 3.0 * c1;
    let mut x = if discriminant > 0.0 {
        // Near a stationary point t the cubic is value(t) + (3t + c₂)(x − t)²: start at the root of that parabola.
        let root = discriminant.sqrt();
        let maximum = (-c2 - root) / 3.0;
        let at_maximum = value(maximum);
        if at_maximum > 0.0 {
            maximum - (at_maximum / root).sqrt()
        } else {
            let minimum = (-c2 + root) / 3.0;
            minimum + (-value(minimum) / root).max(0.0).sqrt()
        }
    } else {
        // Monotone: around the inflection t³ + pt + q with p ≥ 0, whose root is no farther out than |q|/p and ∛|q|.
        let inflection = -c2 / 3.0;
        let (p, q) = (discriminant.abs() / 3.0, value(inflection));
        inflection - q.abs().cbrt().min(q.abs() / p).copysign(q)
    };
    let mut last = f64::INFINITY;
    for _ in 0..MAX_CUBIC_STEPS {
        let step = value(x) / slope(x);
        // At the limit of precision steps stop shrinking.
        if step.abs() < last {
            x -= step;
            last = step.abs();
        } else {
            break;
        }
    }
    x
}

/// The real roots of a + bx + cx² = 0; both equal for a double root.
pub(crate) fn quadratic_roots(a: f64, b: f64, c: f64) -> Option<[f64; 2]> {
    let discriminant = b * b - 4.0 * a * c;
    if discriminant < 0.0 {
        return None;
    }
    // The sum without cancellation; the other root from the product of both.
    let q = -0.5 * (b + discriminant.sqrt().copysign(b));
    Some([q / c, if q == 0.0 { q / c } else { a / q }])
}

/// The real roots of c₀ + c₁x + c₂x² + c₃x³ = 0.
pub(crate) fn cubic_roots([c0, c1, c2, c3]: [f64; 4]) -> ArrayVec<f64, 3> {
    let mut roots = ArrayVec::new();
    let size = c0.abs().max(c1.abs()).max(c2.abs());
    if c3.abs() <= f64::EPSILON * size {
        roots.extend(quadratic_roots(c0, c1, c2).into_iter().flatten().filter(|x| x.is_finite()));
        return roots;
    }
    let [c0, c1, c2] = [c0 / c3, c1 / c3, c2 / c3];
    let root = cubic_root([c0, c1, c2]);
    roots.push(root);
    // (x − root)(x² + bx + a), the remainder left to rounding.
    let b = c2 + root;
    let a = c1 + root * b;
    roots.extend(quadratic_roots(a, b, 1.0).into_iter().flatten());
    roots
}

/// Coefficients of a polynomial of degree at most 10.
pub(crate) const MAX_TERMS: usize = 11;

/// The real roots of a polynomial of degree at most 10: those of its derivative split the line into monotone pieces, which
/// have at most one root each, and so on down (Yuksel 2022, "High-performance polynomial root finding for graphics").
/// Roots in [−1, 1] come from the polynomial itself, those outside from its reverse, so that powers stay bounded.
/// Double roots, which do not change the sign, are not found.
pub(crate) fn real_roots(coefficients: &[f64; MAX_TERMS]) -> ArrayVec<f64, 10> {
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

fn roots_in_unit_interval(coefficients: &[f64; MAX_TERMS]) -> ArrayVec<f64, 10> {
    // derivatives[k] = p⁽ᵏ⁾/k!, whose coefficients are binomial multiples.
    let mut derivatives = [[0.0; MAX_TERMS]; MAX_TERMS];
    derivatives[0] = *coefficients;
    for k in 1..MAX_TERMS {
        for i in 0..MAX_TERMS - k {
            derivatives[k][i] = derivatives[k - 1][i + 1] * ((i + 1) as f64 / k as f64);
        }
    }
    let mut roots = ArrayVec::<f64, 10>::new();
    for k in (0..MAX_TERMS - 1).rev() {
        let terms = MAX_TERMS - k;
        let (p, dp) = (&derivatives[k][..terms], &derivatives[k + 1][..terms - 1]);
        let mut found = ArrayVec::<f64, 10>::new();
        let mut low = -1.0;
        let mut at_low = evaluate(p, low);
        for high in roots.iter().copied().chain([1.0]) {
            let at_high = evaluate(p, high);
            if (at_low < 0.0) != (at_high < 0.0) && !found.is_full() {
                found.push(bracketed_root(p, dp, (k + 1) as f64, low, high, at_low < 0.0));
            }
            (low, at_low) = (high, at_high);
        }
        roots = found;
    }
    roots
}

fn evaluate(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// Newton steps and halvings: a bracket of length 2 is halved down to rounding in 53.
const MAX_BRACKET_STEPS: usize = 60;

/// The root of `p` between `low` and `high`, where it rises (or else falls) through zero; Newton's method, halving the bracket
/// where a step leaves it. The derivative of `p` is `factor · dp`.
fn bracketed_root(p: &[f64], dp: &[f64], factor: f64, mut low: f64, mut high: f64, rises: bool) -> f64 {
    let mut x = 0.5 * (low + high);
    for _ in 0..MAX_BRACKET_STEPS {
        let value = evaluate(p, x);
        if (value < 0.0) == rises {
            low = x;
        } else {
            high = x;
        }
        let newton = x - value / (factor * evaluate(dp, x));
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - x).abs() <= f64::EPSILON * x.abs() {
            return next;
        }
        x = next;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;

    /// Polynomials made from known roots; the roots are well apart, so that their coefficients determine them well.
    #[test]
    fn finds_the_roots_that_were_put_in() {
        let mut rng = Rng::stream(1, &[]);
        for _ in 0..2000 {
            let mut expected: Vec<f64> = (0..2 * rng.below(6)).map(|_| (rng.normal() * 1.5).sinh()).collect();
            expected.sort_by(f64::total_cmp);
            if expected.windows(2).any(|pair| pair[1] - pair[0] < 0.1) {
                continue;
            }
            let mut p = [0.0; MAX_TERMS];
            p[0] = 1.0;
            for root in &expected {
                for i in (0..MAX_TERMS).rev() {
                    p[i] = if i > 0 { p[i - 1] } else { 0.0 } - root * p[i];
                }
            }
            // Complex pairs fill the degree: x² + ax + 1 with |a| < 2.
            for _ in 0..(10 - expected.len()) / 2 {
                let a = 3.0 * rng.uniform() - 1.5;
                for i in (0..MAX_TERMS).rev() {
                    p[i] += if i > 0 { a * p[i - 1] } else { 0.0 } + if i > 1 { p[i - 2] } else { 0.0 };
                }
            }
            let mut found = real_roots(&p);
            found.sort_by(f64::total_cmp);
            assert_eq!(found.len(), expected.len(), "{expected:?} {found:?}");
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-6 * (1.0 + expected.abs()), "{expected:?} {found:?}");
            }
        }
    }

    #[test]
    fn cubics() {
        let mut rng = Rng::stream(2, &[]);
        for _ in 0..10_000 {
            let scale = 10f64.powf(6.0 * rng.uniform() - 3.0);
            let [a, b, c] = [rng.normal() * scale, rng.normal() * scale, rng.normal() * scale];
            let gap = (a - b).abs().min((a - c).abs()).min((b - c).abs());
            if gap < 1e-2 * scale {
                continue;
            }
            let roots = cubic_roots([-a * b * c, a * b + a * c + b * c, -a - b - c, 1.0]);
            for expected in [a, b, c] {
                assert!(roots.iter().any(|x| (x - expected).abs() < 1e-9 * scale), "{roots:?} {expected}");
            }
        }
        assert_eq!(cubic_roots([-8.0, 0.0, 0.0, 1.0]).as_slice(), &[2.0]);
        // A triple root is determined to the cube root of the precision only.
        assert!(cubic_roots([-1.0, 3.0, -3.0, 1.0]).iter().any(|x| (x - 1.0).abs() < 1e-5));
    }
}
