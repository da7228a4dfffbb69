//! What a caller may choose.

use crate::brute::Isa;
use crate::error::Error;
use crate::forest::Checks;

/// Which neighbours become matches. The defaults are COLMAP's.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Lowe's ratio test: the angle to the best partner must be less than this times the angle to
    /// the second best. `None` leaves the test out.
    pub max_ratio: Option<f64>,
    /// Largest angle between the two descriptors, in radians. `None` allows any.
    pub max_angle_rad: Option<f64>,
    /// Whether both features must be each other's best partner, and pass the tests above in both
    /// directions.
    pub mutual: bool,
    /// How neighbours are found.
    pub method: Method,
    /// Give up on pairs of images whose largest features hardly match. `None` matches every pair in
    /// full.
    pub preempt: Option<Preempt>,
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
    /// Checks numbers that came from a user. Matching itself accepts any: a ratio or an angle that
    /// makes no sense lets no match through.
    pub fn validate(&self) -> Result<(), Error> {
        check("max_ratio", self.max_ratio, 1.0, "above 0 and at most 1")?;
        check("max_angle_rad", self.max_angle_rad, std::f64::consts::PI, "above 0 and at most pi")
    }
}

fn check(
    name: &'static str,
    value: Option<f64>,
    most: f64,
    range: &'static str,
) -> Result<(), Error> {
    match value {
        Some(value) if !(value > 0.0 && value <= most) => Err(Error::Option { name, value, range }),
        _ => Ok(()),
    }
}

/// How the nearest neighbours are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// By comparing all with all: exact, and the same on every machine.
    #[default]
    BruteForce,
    /// In the forests of the images ([`crate::Prepared::grow_forest`]); by brute force where an
    /// image has none.
    Forest(Checks),
    /// Whichever of the two should take less time on this machine. Which neighbours the forest
    /// misses then depends on the machine as well.
    Cheapest(Checks),
}

impl Method {
    /// Whether two images with so many features each are matched by forests, if they have them.
    pub fn uses_forest(self, features: usize) -> bool {
        self.is_forest_for(features, features)
    }

    pub(crate) fn is_forest_for(self, features_a: usize, features_b: usize) -> bool {
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

/// Time for all nearest neighbours in both directions: a constant for each pair of features.
fn brute_force_ns(isa: Isa, features_a: usize, features_b: usize) -> f64 {
    isa.pair_ns() * features_a as f64 * features_b as f64
}

/// The same by forests of eight trees: a constant for each check, and one that comes in for each
/// doubling of the searched image, for deeper trees and caches that hold less of it.
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

/// Measured on Zen 5 with 8192 points.
const CHECK_NS: f64 = 105.0;
/// Measured on Zen 5 from 8192 to 1,000,000 points.
const CHECK_DOUBLING_NS: f64 = 48.0;

/// Preemptive matching (Wu 2013, "Towards linear-time incremental structure from motion", section
/// 3): features of large scale are few, repeatable and found in both images if anything is. Match
/// those first.
///
/// With 1024 leading features, 1/64 of the work, the default lost none of 1,278 verified pairs of
/// five data sets; asking for 4 matches lost pairs of up to 23 inliers, with 256 leading features
/// of up to 387 (`bench/matching.py preempt`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Preempt {
    /// How many matches among the leading features let a pair go on to full matching. How many
    /// features lead was chosen when the images were prepared ([`crate::Prepared::from_features`]).
    pub min_matches: u32,
}

impl Default for Preempt {
    fn default() -> Self {
        Preempt { min_matches: 2 }
    }
}
