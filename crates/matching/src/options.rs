//! What a caller may choose.

use crate::error::Error;

/// Which neighbours become matches. The defaults are COLMAP's.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Lowe's ratio test: the angle to the best partner must be less than this times the angle to the second best.
    /// `None` leaves the test out.
    pub max_ratio: Option<f64>,
    /// Largest angle between the two descriptors, in radians. `None` allows any.
    pub max_angle_rad: Option<f64>,
    /// Whether both features must be each other's best partner, and pass the tests above in both directions.
    pub mutual: bool,
    /// Give up on pairs of images whose largest features hardly match. `None` matches every pair in full.
    pub preempt: Option<Preempt>,
}

impl Default for Options {
    fn default() -> Self {
        Options { max_ratio: Some(0.8), max_angle_rad: Some(0.7), mutual: true, preempt: None }
    }
}

impl Options {
    /// Checks numbers that came from a user. Matching itself accepts any: a ratio or an angle that makes no sense
    /// lets no match through.
    pub fn validate(&self) -> Result<(), Error> {
        check("max_ratio", self.max_ratio, 1.0, "above 0 and at most 1")?;
        check("max_angle_rad", self.max_angle_rad, std::f64::consts::PI, "above 0 and at most pi")
    }
}

fn check(name: &'static str, value: Option<f64>, most: f64, range: &'static str) -> Result<(), Error> {
    match value {
        Some(value) if !(value > 0.0 && value <= most) => Err(Error::Option { name, value, range }),
        _ => Ok(()),
    }
}

/// Preemptive matching (Wu 2013, "Towards linear-time incremental structure from motion", section 3): features of
/// large scale are few, repeatable and found in both images if anything is. Match those first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Preempt {
    /// How many matches among the leading features let a pair go on to full matching. How many features lead was
    /// chosen when the images were prepared ([`crate::Prepared::from_features`]).
    pub min_matches: u32,
}
