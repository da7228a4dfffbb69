//! Options of descriptor matching.

use crate::brute::Isa;
use crate::error::Error;
use crate::forest::Checks;

/// Options of descriptor matching. The defaults are those of COLMAP.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Lowe's ratio test: the angle to the nearest descriptor must be below this ratio times the
    /// angle to the second nearest. For other descriptors than those of SIFT, it compares
    /// Euclidean distances. `None` disables the test.
    pub max_ratio: Option<f64>,
    /// Maximum angle between two descriptors, in radians. `None` disables the test.
    pub max_angle_rad: Option<f64>,
    /// Cross check: two features must be each other's nearest neighbours, and pass the tests above
    /// in both directions.
    pub mutual: bool,
    /// Method of the nearest-neighbour search.
    pub method: Method,
    /// Preemptive matching: rejects image pairs whose largest features have too few matches. `None`
    /// matches all features of every pair.
    pub preempt: Option<PreemptiveMatching>,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            max_ratio: Some(0.8),
            max_angle_rad: Some(0.7),
            mutual: true,
            method: Method::BruteForce,
            preempt: None,
        }
    }
}

impl Options {
    /// Checks that the options are in their ranges. Matching does not check them: with an invalid
    /// ratio or angle it returns no matches.
    ///
    /// # Errors
    /// [`Error::Option`] with the first option that is out of its range.
    pub fn validate(&self) -> Result<(), Error> {
        check("max_ratio", self.max_ratio, 1.0, "above 0 and at most 1")?;
        check("max_angle_rad", self.max_angle_rad, std::f64::consts::PI, "above 0 and at most pi")
    }
}

/// Checks that an option is above zero and at most `max`.
fn check(
    name: &'static str,
    value: Option<f64>,
    max: f64,
    range: &'static str,
) -> Result<(), Error> {
    match value {
        Some(value) if !(value > 0.0 && value <= max) => Err(Error::Option { name, value, range }),
        _ => Ok(()),
    }
}

/// Method of the nearest-neighbour search.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Brute force: exact, with the same result on every CPU. The method for descriptors other than
    /// those of SIFT, whatever this option says.
    #[default]
    BruteForce,
    /// Approximate search in the kd-forests of the images ([`crate::forest`]); brute
    /// force if an image has no forest.
    Forest(Checks),
    /// The method of the shorter estimated time on this CPU. The result can therefore depend on the
    /// CPU.
    Cheapest(Checks),
}

impl Method {
    /// Whether two images of this number of features are matched by forests, if they have forests.
    pub fn uses_forest(self, features: usize) -> bool {
        self.uses_forest_for_pair(features, features)
    }

    /// Whether two images with these numbers of features are matched by forests, if they have them.
    pub(crate) fn uses_forest_for_pair(self, features_a: usize, features_b: usize) -> bool {
        match self {
            Method::BruteForce => false,
            Method::Forest(_) => true,
            Method::Cheapest(checks) => {
                forest_ns(features_a, features_b, checks)
                    < brute_force_ns(Isa::best(), features_a, features_b)
            }
        }
    }
}

/// Estimated time of brute force in both directions, in nanoseconds.
fn brute_force_ns(isa: Isa, features_a: usize, features_b: usize) -> f64 {
    isa.pair_ns() * features_a as f64 * features_b as f64
}

/// Estimated time of forests of eight trees in both directions, in nanoseconds. The time per check
/// increases with each doubling of the number of points, because of deeper trees and cache misses.
fn forest_ns(features_a: usize, features_b: usize, checks: Checks) -> f64 {
    let checks = match checks {
        Checks::Total(checks) => f64::from(checks),
        Checks::PerTree(checks) => 8.0 * f64::from(checks),
    };
    let one_way = |queries: usize, points: usize| {
        let doublings = (points as f64 / 8192.0).max(1.0).log2();
        queries as f64 * checks * (CHECK_NS + CHECK_DOUBLING_NS * doublings)
    };
    one_way(features_a, features_b) + one_way(features_b, features_a)
}

/// Time per check for 8192 points, measured on Zen 5.
const CHECK_NS: f64 = 105.0;
/// Increase of the time per check for each doubling of the number of points, measured on Zen 5 from
/// 8192 to 1,000,000 points.
const CHECK_DOUBLING_NS: f64 = 48.0;

/// Preemptive matching (Wu 2013, "Towards linear-time incremental structure from motion", section
/// 3): the features of the largest scales, which are few and repeatable, are matched first. Image
/// pairs with too few of these matches are rejected.
///
/// With 1024 leading features, 1/64 of the work, the default rejected none of 1,278 verified pairs
/// of five data sets. A minimum of 4 matches rejected pairs with up to 23 inliers, and 256 leading
/// features rejected pairs with up to 387 inliers (`bench/matching.py preempt`). Of the 227
/// verified pairs of the set lund it rejects one with 21 inliers, and of 179 others only 18: it is
/// off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PreemptiveMatching {
    /// Minimum number of matches among the leading features.
    pub min_matches: u32,
}

impl PreemptiveMatching {
    /// Number of leading features of an image.
    pub const NUM_LEADING: usize = 1024;
}

impl Default for PreemptiveMatching {
    fn default() -> Self {
        PreemptiveMatching { min_matches: 2 }
    }
}
