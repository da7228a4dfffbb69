//! How probable a depth is to be right: within five footprints of the surface, where a footprint is
//! the depth over the focal length.
//!
//! The odds grow with the angle between the rays, since a pixel of error is a footprint of depth
//! over that angle, and by factors for sources that agree and for a low cost. The factors are those
//! of a logistic regression on scenes that no table has (`docs/benchmarks/dense.md`).

use super::cost::Support;

/// Odds at an angle of 1 rad, without cost and support.
const ODDS: f32 = 31.4;
/// Logarithm of the factor of a cost of 1.
const COST: f32 = -3.33;
/// Logarithm of the factor of a source that agrees exactly.
const SUPPORT: f32 = 0.28;

/// The probability that a depth of this cost and support is right.
pub(super) fn confidence(cost: f32, support: &Support) -> f32 {
    let odds = ODDS * support.angle * (COST * cost + SUPPORT * support.sources).exp();
    odds / (1.0 + odds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_depth_gains_by_agreement_angle_and_low_cost() {
        let of = |cost, sources, angle| confidence(cost, &Support { count: 1, sources, angle });
        let usual = of(0.2, 2.0, 0.5);
        assert!((0.9..0.95).contains(&usual), "{usual}");
        for worse in [of(0.4, 2.0, 0.5), of(0.2, 1.0, 0.5), of(0.2, 2.0, 0.25)] {
            assert!(worse < usual, "{worse} {usual}");
        }
        assert_eq!(of(0.2, 2.0, 0.0), 0.0);
        assert!(of(0.0, 8.0, f32::MAX.sqrt()) <= 1.0);
    }
}
