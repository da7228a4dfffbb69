//! The baseline constraint between two moments: E = ½ w ‖p_i − p_{i+1}‖² (Huang, Elhashash & Qin
//! 2022, Eq. 3).
//!
//! It joins four camera poses, the left and the right one at time i and at time i + 1, and knows
//! nothing of the calibration: only that it stays. It weighs metres against radians, so its
//! strength depends on the unit of the model; see [`crate::paper`].
//!
//! A rotation has many axis-angle vectors, and which of them is the shortest changes at π, where
//! cameras that look in opposite directions are. A difference of shortest vectors would change sign
//! there, so the factor writes both rotations by the vectors nearest to a given one.

use tiepoint_ba::{Factor, Linear, Refs};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::SVector;

use crate::relative_pose::RelativePose;

/// The relative pose of two cameras equals that at the next moment. Variables: `left_from_world`
/// and `right_from_world` at time i, then the same at time i + 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Baseline {
    /// Square root of the weight w (units: 1 / model unit for the translation, 1 / radian for the
    /// rotation).
    pub sqrt_weight: f64,
    /// Both rotations are written by the axis-angle vectors nearest to that of this relative pose,
    /// say the first one's.
    pub near: RelativePose,
}

impl Baseline {
    /// With weight w: Eq. (2)'s λ N_p/N_t, or Eq. (4)'s λ_i.
    pub fn with_weight(weight: f64, near: RelativePose) -> Self {
        Self { sqrt_weight: weight.sqrt(), near }
    }
}

impl Factor<6> for Baseline {
    type Vars = (Rigid3, Rigid3, Rigid3, Rigid3);

    fn linearize(
        &self,
        (left, right, next_left, next_right): Refs<'_, Self::Vars>,
    ) -> Option<Linear<Self::Vars, 6>> {
        let now = RelativePose::linearize(left, right).nearest_to(&self.near);
        let next = RelativePose::linearize(next_left, next_right).nearest_to(&self.near);
        let w = self.sqrt_weight;
        let residual = (now.p.to_vector() - next.p.to_vector()) * w;
        Some((residual, (now.d_left * w, now.d_right * w, next.d_left * -w, next.d_right * -w)))
    }

    fn residual(
        &self,
        (left, right, next_left, next_right): Refs<'_, Self::Vars>,
    ) -> Option<SVector<f64, 6>> {
        let now = RelativePose::between(left, right).nearest_to(&self.near);
        let next = RelativePose::between(next_left, next_right).nearest_to(&self.near);
        Some((now.to_vector() - next.to_vector()) * self.sqrt_weight)
    }
}
