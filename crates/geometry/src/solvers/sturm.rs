//! The real roots of a polynomial of degree ten, isolated by Sturm's theorem and refined by
//! Newton's method (Hook and McAree 1990, "Using Sturm sequences to bracket real roots of
//! polynomial equations", Graphics Gems).
//!
//! The Sturm chain is p, p', and then each negative remainder of the two polynomials before it. The
//! number of its sign changes at a minus that at b is the number of distinct roots of p between a
//! and b. The chain is stored as its linear quotients and its last two elements, from which it is
//! evaluated backwards. The bisection is over s in (−1, 1) with x = s/(1 − |s|), so that roots of
//! any magnitude need few bisections.

use arrayvec::ArrayVec;

/// Degree of the polynomials.
pub(crate) const DEGREE: usize = 10;

/// Coefficients, ascending.
pub(crate) type Polynomial = [f64; DEGREE + 1];

/// The search interval is |s| ≤ this, which is |x| ≤ 1e9.
const LIMIT: f64 = 1.0 - 1e-9;

/// Bisection stops at this width in s. An interval of this width with several roots is dropped.
const MIN_WIDTH: f64 = 1e-12;

/// Capacity of the interval stack: each bisection adds one, at most log₂(2 / [`MIN_WIDTH`]) = 41.
const MAX_INTERVALS: usize = 48;

/// Maximum number of Newton and bisection steps; five or six are usual.
const MAX_STEPS: usize = 60;

/// The distinct real roots of odd multiplicity; none if the leading coefficient is zero.
pub(crate) fn real_roots(coefficients: &Polynomial) -> ArrayVec<f64, DEGREE> {
    let mut roots = ArrayVec::new();
    let Some(chain) = SturmChain::new(coefficients) else { return roots };
    let mut intervals = ArrayVec::<_, MAX_INTERVALS>::new();
    intervals.push([(-LIMIT, chain.sign_changes(-LIMIT)), (LIMIT, chain.sign_changes(LIMIT))]);
    while let Some([(low, at_low), (high, at_high)]) = intervals.pop() {
        // Because of rounding the sign changes can increase from low to high.
        let count = at_low.saturating_sub(at_high);
        if count == 0 || roots.is_full() {
            continue;
        }
        if count == 1 {
            roots.extend(bracketed_root(&chain.p, low, high));
        } else if high - low > MIN_WIDTH {
            let middle = 0.5 * (low + high);
            let at_middle = chain.sign_changes(middle);
            intervals.push([(middle, at_middle), (high, at_high)]);
            intervals.push([(low, at_low), (middle, at_middle)]);
        }
    }
    roots
}

/// x(s) = s / (1 − |s|).
fn x_of(s: f64) -> f64 {
    s / (1.0 - s.abs())
}

/// A Sturm chain.
struct SturmChain {
    /// The polynomial, scaled to a leading coefficient of one.
    p: Polynomial,
    /// Element i of the chain is (offset + slope x) · element i+1 + weight · element i+2, up to
    /// positive factors.
    offset: [f64; DEGREE - 1],
    slope: [f64; DEGREE - 1],
    weight: [f64; DEGREE - 1],
    /// The last but one element: a₀ + a₁x.
    linear: [f64; 2],
    /// The last element.
    constant: f64,
}

impl SturmChain {
    fn new(coefficients: &Polynomial) -> Option<Self> {
        let inverse = 1.0 / coefficients[DEGREE];
        let p = coefficients.map(|c| c * inverse);
        let mut first = p;
        let mut second: Polynomial = std::array::from_fn(|i| {
            p.get(i + 1).map_or(0.0, |c| c * (i + 1) as f64 / DEGREE as f64)
        });
        let mut chain = Self {
            p,
            offset: [0.0; DEGREE - 1],
            slope: [0.0; DEGREE - 1],
            weight: [0.0; DEGREE - 1],
            linear: [0.0; 2],
            constant: 0.0,
        };
        for i in 0..DEGREE - 1 {
            // `first` has degree n and `second` n − 1, with leading coefficients ±1.
            let n = DEGREE - i;
            let lead = second[n - 1];
            let slope = first[n] * lead;
            let offset = (first[n - 1] - slope * second[n - 2]) * lead;
            let mut remainder = [0.0; DEGREE + 1];
            remainder[0] = first[0] - offset * second[0];
            for j in 1..n - 1 {
                remainder[j] = first[j] - offset * second[j] - slope * second[j - 1];
            }
            let weight = -remainder[n - 2].abs();
            let inverse = 1.0 / weight;
            (chain.offset[i], chain.slope[i], chain.weight[i]) = (offset, slope, weight);
            first = second;
            second = remainder.map(|c| c * inverse);
        }
        chain.linear = [first[0], first[1]];
        chain.constant = second[0];
        (inverse.is_finite() && chain.constant.is_finite()).then_some(chain)
    }

    /// Number of sign changes of the chain at x(s).
    fn sign_changes(&self, s: f64) -> u32 {
        let x = x_of(s);
        let mut after = self.constant;
        let mut element = self.linear[0] + self.linear[1] * x;
        let mut signs = u32::from(after < 0.0) << 1 | u32::from(element < 0.0);
        for i in (0..DEGREE - 1).rev() {
            let before = (self.offset[i] + self.slope[i] * x) * element + self.weight[i] * after;
            (after, element) = (element, before);
            signs = signs << 1 | u32::from(before < 0.0);
        }
        ((signs ^ (signs >> 1)) & ((1 << DEGREE) - 1)).count_ones()
    }
}

/// The value and derivative at x by Estrin's scheme, whose dependency chain is shorter than that of
/// Horner's.
fn evaluate(p: &Polynomial, x: f64) -> [f64; 2] {
    let (x2, pairs) = (x * x, |c: [f64; 2]| c[0] + c[1] * x);
    let x4 = x2 * x2;
    let estrin = |c: [f64; 11]| {
        let low = pairs([c[0], c[1]]) + pairs([c[2], c[3]]) * x2;
        let high = pairs([c[4], c[5]]) + pairs([c[6], c[7]]) * x2;
        let top = pairs([c[8], c[9]]) + c[10] * x2;
        low + (high + top * x4) * x4
    };
    let derivative =
        std::array::from_fn(|i| if i < DEGREE { p[i + 1] * (i + 1) as f64 } else { 0.0 });
    [estrin(*p), estrin(derivative)]
}

/// The root between x(low) and x(high) by Newton's method, with bisection in s if a step leaves the
/// bracket. `None` if p does not change its sign.
fn bracketed_root(p: &Polynomial, mut low: f64, mut high: f64) -> Option<f64> {
    let falls = evaluate(p, x_of(low))[0] > 0.0;
    if (evaluate(p, x_of(high))[0] > 0.0) == falls {
        return None;
    }
    let (mut x_low, mut x_high) = (x_of(low), x_of(high));
    let mut x = x_of(0.5 * (low + high));
    for _ in 0..MAX_STEPS {
        let [value, slope] = evaluate(p, x);
        let s = x / (1.0 + x.abs());
        if (value > 0.0) == falls {
            (low, x_low) = (s, x);
        } else {
            (high, x_high) = (s, x);
        }
        let newton = x - value / slope;
        let next =
            if newton > x_low && newton < x_high { newton } else { x_of(0.5 * (low + high)) };
        if (next - x).abs() <= 4.0 * f64::EPSILON * x.abs() {
            return Some(next);
        }
        x = next;
    }
    Some(x)
}

#[cfg(test)]
#[path = "sturm_tests.rs"]
mod tests;
