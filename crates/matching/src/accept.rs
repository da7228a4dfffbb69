//! The ratio test and the maximum angle, with the angles of COLMAP, on squared integer distances.
//!
//! Descriptors have norm 512, so a squared distance `d` is the squared length of a chord: with
//! `u = d / 1024²` the angle is `θ = 2 asin √u`. The tests are `θ₁ ≤ θ_max` and `θ₁ < r θ₂`. Both
//! compare `d₁` with a threshold. For the ratio test it is
//!
//! `d₁ / 1024² < sin²(r asin √u₂) = ½ (1 − cos(2r asin √u₂))`.
//!
//! `y(s) = cos(2r asin s)` solves `(1 − s²) y″ − s y′ + 4r² y = 0` with `y(0) = 1, y′(0) = 0`, so
//! it is a power series in `u = s²`: `c₀ = 1, c_{k+2} = c_k (k² − 4r²) / ((k+1)(k+2))`. Entries of
//! descriptors are not negative. The angle is therefore at most π/2 and `u ≤ ½`, and each term is
//! less than half of the previous term. The polynomial replaces `asin` and `sin`, because the last
//! bit of these library functions can depend on the platform.

use crate::matches::{DIAMETER_SQUARED, Nearest};
use crate::options::Options;

/// Number of terms of the series: the next term is below 2⁻⁵³ of the sum for u ≤ ½.
const TERMS: usize = 48;

/// The ratio test and the maximum angle of an [`Options`], with precomputed constants.
pub(crate) struct Acceptance {
    /// Coefficients of the threshold of the ratio test, a polynomial in `u` without constant term,
    /// times 1024²; `None` for no ratio test.
    ratio: Option<[f64; TERMS]>,
    /// Lower and upper bound of the threshold over the second distance, for any second distance.
    ratio_bounds: [f64; 2],
    /// Maximum squared distance.
    max_distance: f64,
}

/// Relative margin of the bounds, larger than the rounding error of the threshold.
const MARGIN: f64 = 1e-9;

impl Acceptance {
    pub(crate) fn new(options: &Options) -> Self {
        let ratio = options.max_ratio.map(|r| ratio_series(r.max(0.0)));
        // sin²(r asin s) / s² increases from r² at s = 0 to its value at s² = ½ for r ≤ 1.
        let ratio_bounds = match (&ratio, options.max_ratio) {
            (Some(series), Some(r)) if r > 0.0 && r <= 1.0 => [
                r * r * (1.0 - MARGIN),
                2.0 * threshold(series, 0.5) / DIAMETER_SQUARED * (1.0 + MARGIN),
            ],
            _ => [0.0, f64::INFINITY],
        };
        Acceptance {
            ratio,
            ratio_bounds,
            max_distance: match options.max_angle_rad {
                Some(angle) if angle >= std::f64::consts::PI => f64::INFINITY,
                // A negative or NaN angle accepts no distance.
                Some(angle) if angle >= 0.0 => DIAMETER_SQUARED * (0.5 * angle).sin().powi(2),
                Some(_) => -1.0,
                None => f64::INFINITY,
            },
        }
    }

    /// Whether the nearest neighbour passes the maximum angle and the ratio test.
    #[inline]
    pub(crate) fn accepts(&self, nearest: &Nearest) -> bool {
        if nearest.index == u32::MAX || f64::from(nearest.distance) > self.max_distance {
            return false;
        }
        let Some(series) = &self.ratio else { return true };
        let u = (f64::from(nearest.second) / DIAMETER_SQUARED).min(0.5);
        let (distance, second) = (f64::from(nearest.distance), DIAMETER_SQUARED * u);
        if distance < self.ratio_bounds[0] * second {
            return true;
        }
        distance <= self.ratio_bounds[1] * second && distance < threshold(series, u)
    }

    /// Whether there are limits of distances: the ratio is not invalid.
    pub(crate) fn has_limits(&self) -> bool {
        self.ratio.is_none() || self.ratio_bounds[0] > 0.0
    }

    /// The squared distance above which another descriptor does not change the decision: if the
    /// nearest one is accepted, it does not make it fail; if not, it is not accepted with that one
    /// as second. Negative if no descriptor does. Needs [`Self::has_limits`].
    pub(crate) fn limit(&self, nearest: &Nearest) -> f64 {
        let distance = f64::from(nearest.distance);
        if self.ratio.is_none() {
            return distance.min(self.max_distance);
        }
        let [least, largest] = self.ratio_bounds;
        if self.accepts(nearest) {
            return distance / least;
        }
        if nearest.distance == 0 {
            return -1.0;
        }
        // The threshold over the second distance is a power series with positive coefficients, and
        // therefore below its chord.
        let part = (2.0 * distance / DIAMETER_SQUARED).min(1.0);
        let threshold = distance * (least + part * (largest - least)) * (1.0 + 4.0 * MARGIN);
        threshold.min(self.max_distance)
    }

    /// Maximum squared distance.
    pub(crate) fn max_distance(&self) -> f64 {
        self.max_distance
    }
}

/// The threshold of the ratio test for `u` of the second distance.
fn threshold(series: &[f64; TERMS], u: f64) -> f64 {
    u * series.iter().rev().fold(0.0, |sum, c| sum * u + c)
}

/// Coefficients of `1024² sin²(r asin √u)` for `u¹, u², …`.
fn ratio_series(r: f64) -> [f64; TERMS] {
    let mut series = [0.0; TERMS];
    let mut c = 1.0;
    for (half_k, out) in series.iter_mut().enumerate() {
        let k = 2.0 * half_k as f64;
        c *= (k * k - 4.0 * r * r) / ((k + 1.0) * (k + 2.0));
        *out = -0.5 * c * DIAMETER_SQUARED;
    }
    series
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matches::angle_rad;

    /// Relative tolerance: distances closer to the threshold may be accepted or rejected because of
    /// rounding.
    const ROUNDING: f64 = 1e-12;

    fn nearest(distance: u32, second: u32) -> Nearest {
        Nearest { index: 0, distance, second }
    }

    #[test]
    fn series_matches_arc_sine() {
        for ratio in [0.1, 0.5, 0.6, 0.7, 0.8, 0.85, 0.95, 1.0] {
            let tests = Acceptance::new(&Options {
                max_ratio: Some(ratio),
                max_angle_rad: None,
                ..Options::default()
            });
            for second in
                (0..600_000).step_by(977).chain([1, 2, 524_287, 524_288, 8_323_200, u32::MAX])
            {
                let exact =
                    DIAMETER_SQUARED * (0.5 * ratio * angle_rad(second.into())).sin().powi(2);
                for distance in
                    [0, exact.floor() as u32, exact.ceil() as u32, (0.5 * exact) as u32, second]
                {
                    if (f64::from(distance) - exact).abs() > ROUNDING * exact {
                        let expected = f64::from(distance) < exact;
                        assert_eq!(
                            tests.accepts(&nearest(distance, second)),
                            expected,
                            "{ratio} {distance} {second}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn descriptors_beyond_the_limit_do_not_change_the_decision() {
        for max_ratio in [None, Some(0.3), Some(0.8), Some(0.95), Some(1.0)] {
            for max_angle_rad in [None, Some(0.0), Some(0.7), Some(4.0)] {
                let options = Options { max_ratio, max_angle_rad, ..Options::default() };
                let acceptance = Acceptance::new(&options);
                assert!(acceptance.has_limits());
                for distance in (0..9_000_000).step_by(49_999).chain([1, 2, 3, 524_288]) {
                    for second in [distance, distance + 1, 2 * distance + 3, u32::MAX] {
                        let nearest = nearest(distance, second);
                        let limit = acceptance.limit(&nearest);
                        let first = if limit < 0.0 { 0 } else { limit as u32 + 1 };
                        for other in [first, first + 1, first + first / 3, u32::MAX] {
                            let mut both = nearest;
                            both.update(1, other);
                            let (before, after) =
                                (acceptance.accepts(&nearest), acceptance.accepts(&both));
                            assert_eq!(before, after, "{options:?} {both:?}");
                        }
                    }
                }
            }
        }
        for ratio in [0.0, -1.0, 1.5, f64::NAN] {
            let options = Options { max_ratio: Some(ratio), ..Options::default() };
            assert!(!Acceptance::new(&options).has_limits());
        }
    }

    #[test]
    fn maximum_angle_and_invalid_options() {
        let only_angle = |angle| {
            Acceptance::new(&Options {
                max_ratio: None,
                max_angle_rad: Some(angle),
                ..Options::default()
            })
        };
        // The chord of 0.7 rad on the sphere of radius 512 has length 351.12.
        assert!(only_angle(0.7).accepts(&nearest(351 * 351, u32::MAX)));
        assert!(!only_angle(0.7).accepts(&nearest(352 * 352, u32::MAX)));
        assert!(only_angle(0.0).accepts(&nearest(0, 0)));
        assert!(only_angle(4.0).accepts(&nearest(8_323_200, 0)));
        for invalid in [f64::NAN, -1.0] {
            assert!(!only_angle(invalid).accepts(&nearest(0, u32::MAX)));
            let ratio = Acceptance::new(&Options {
                max_ratio: Some(invalid),
                max_angle_rad: None,
                ..Options::default()
            });
            assert!(!ratio.accepts(&nearest(0, u32::MAX)));
        }
        assert!(!only_angle(4.0).accepts(&Nearest::NONE));
    }
}
