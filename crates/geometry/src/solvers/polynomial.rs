//! Real roots of quadratic and cubic polynomials. Coefficients are in ascending order.

use arrayvec::ArrayVec;

/// Maximum number of Newton steps on a cubic. From the initial values of [`cubic_root`],
/// convergence is monotone and takes about six steps.
const MAX_CUBIC_STEPS: usize = 50;

/// One real root of x³ + c₂x² + c₁x + c₀, as in Persson and Nordberg 2018 ("Lambda Twist"):
/// Newton's method from a point beyond the stationary points, on the side of the root.
pub(crate) fn cubic_root([c0, c1, c2]: [f64; 3]) -> f64 {
    let value = |x: f64| ((x + c2) * x + c1) * x + c0;
    let slope = |x: f64| (3.0 * x + 2.0 * c2) * x + c1;
    let discriminant = c2 * c2 - 3.0 * c1;
    let mut x = if discriminant > 0.0 {
        // Near a stationary point t the cubic is value(t) + (3t + c₂)(x − t)²: the initial value is
        // a root of that parabola.
        let root = discriminant.sqrt();
        let maximum = (-c2 - root) / 3.0;
        let value_at_maximum = value(maximum);
        if value_at_maximum > 0.0 {
            maximum - (value_at_maximum / root).sqrt()
        } else {
            let minimum = (-c2 + root) / 3.0;
            minimum + (-value(minimum) / root).max(0.0).sqrt()
        }
    } else {
        // Monotone. With t = x − inflection the cubic is t³ + pt + q with p ≥ 0, whose root is at
        // most min(|q|/p, ∛|q|) from zero.
        let inflection = -c2 / 3.0;
        let (p, q) = (discriminant.abs() / 3.0, value(inflection));
        inflection - q.abs().cbrt().min(q.abs() / p).copysign(q)
    };
    let mut last = f64::INFINITY;
    for _ in 0..MAX_CUBIC_STEPS {
        let step = value(x) / slope(x);
        // Converged to rounding when steps do not become smaller.
        if step.abs() < last {
            x -= step;
            last = step.abs();
        } else {
            break;
        }
    }
    x
}

/// The real roots of a + bx + cx² = 0; two equal roots for a double root.
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
    // Deflation: (x − root)(x² + bx + a), without the remainder, which is rounding error.
    let b = c2 + root;
    let a = c1 + root * b;
    roots.extend(quadratic_roots(a, b, 1.0).into_iter().flatten());
    roots
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;

    #[test]
    fn cubic_roots_recovers_known_roots() {
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
                assert!(
                    roots.iter().any(|x| (x - expected).abs() < 1e-9 * scale),
                    "{roots:?} {expected}"
                );
            }
        }
        assert_eq!(cubic_roots([-8.0, 0.0, 0.0, 1.0]).as_slice(), &[2.0]);
        // A triple root is accurate to the cube root of the machine precision only.
        assert!(cubic_roots([-1.0, 3.0, -3.0, 1.0]).iter().any(|x| (x - 1.0).abs() < 1e-5));
    }
}
