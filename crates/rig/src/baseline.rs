//! The baseline constraint between two frames: E = ½ w ‖p_i − p_{i+1}‖² (Huang, Elhashash & Qin
//! 2022, Eq. 3).
//!
//! The factor connects four camera poses: two cameras at time i and at time i + 1. It assumes that
//! their relative pose is constant, and does not know its value. It weighs metres against radians,
//! so its strength depends on the unit of the model; see [`crate::paper`].
//!
//! A rotation has several axis-angle vectors, and the shortest one jumps at π, where cameras look
//! in opposite directions. A difference of shortest vectors would change its sign there, so the
//! factor represents both rotations by the vectors nearest to a given one.

use tiepoint_ba::Factor;
use tiepoint_ba::factor::{Linear, Refs};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::SVector;

use crate::relative_pose::RelativePose;

/// The relative pose of two cameras equals that at the next frame. Variables: `rig_from_world` and
/// `cam_from_world` at time i, then at time i + 1. Residual: √w (p_i − p_{i+1}), translation
/// first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Baseline {
    /// Square root of the weight w (units: 1 / model unit for the translation, 1 / radian for the
    /// rotation).
    pub sqrt_weight: f64,
    /// Both rotations are represented by the axis-angle vectors nearest to that of this relative
    /// pose, for example the one at the first frame.
    pub near: RelativePose,
}

impl Baseline {
    /// With weight w: λ N_p/N_t of Eq. (2), or λ_i of Eq. (4).
    pub fn with_weight(weight: f64, near: RelativePose) -> Self {
        Self { sqrt_weight: weight.sqrt(), near }
    }
}

impl Factor<6> for Baseline {
    type Vars = (Rigid3, Rigid3, Rigid3, Rigid3);

    fn linearize(
        &self,
        (reference, cam, next_reference, next_cam): Refs<'_, Self::Vars>,
    ) -> Option<Linear<Self::Vars, 6>> {
        let now = RelativePose::linearize(reference, cam).nearest_to(&self.near);
        let next = RelativePose::linearize(next_reference, next_cam).nearest_to(&self.near);
        let w = self.sqrt_weight;
        let residual = (now.p.to_vector() - next.p.to_vector()) * w;
        Some((
            residual,
            (now.d_reference * w, now.d_cam * w, next.d_reference * -w, next.d_cam * -w),
        ))
    }

    fn residual(
        &self,
        (reference, cam, next_reference, next_cam): Refs<'_, Self::Vars>,
    ) -> Option<SVector<f64, 6>> {
        let now = RelativePose::between(reference, cam).nearest_to(&self.near);
        let next = RelativePose::between(next_reference, next_cam).nearest_to(&self.near);
        Some((now.to_vector() - next.to_vector()) * self.sqrt_weight)
    }
}
