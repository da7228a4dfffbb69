//! A mounting held between images of two cameras that were not taken at one instant.
//!
//! The residual is that of [`Mounted`] with the left camera's pose interpolated ([`Knots`]) at the time that the right camera's clock
//! gives it: the clock is a variable too, and the chain rule does the rest.

use tiepoint_ba::{Factor, Linear, Refs};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{SMatrix, SVector, Vector2};

use crate::{Clock, Knots, Mounted};

/// Two cameras are mounted on one rig: variables four consecutive `left_from_world`, one `right_from_world`, `right_from_left`, and
/// the right camera's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MountedInTime {
    /// How firmly.
    pub mounted: Mounted,
    /// When the four left images were taken, on the left camera's clock.
    pub left_times_s: [f64; 4],
    /// When the right image was taken, on its own clock.
    pub right_time_s: f64,
}

impl Factor<6> for MountedInTime {
    type Vars = (Rigid3, Rigid3, Rigid3, Rigid3, Rigid3, Rigid3, Clock);

    fn linearize(
        &self,
        (a, b, c, d, right, mount, clock): Refs<'_, Self::Vars>,
    ) -> Option<Linear<Self::Vars, 6>> {
        let knots = Knots { poses: [a, b, c, d], times_s: self.left_times_s };
        let left = knots.linearize(clock.reference_time_s(self.right_time_s));
        let (residual, (d_left, d_right, d_mount)) = self.mounted.linearize((&left.pose, right, mount))?;
        let [a, b, c, d] = left.d_knots.map(|d_knot| d_left * d_knot);
        let d_time: SVector<f64, 6> = d_left * left.d_time;
        let by_clock = Vector2::new(1.0, self.right_time_s - clock.pivot_s);
        let d_clock: SMatrix<f64, 6, 2> = d_time * by_clock.transpose();
        Some((residual, (a, b, c, d, d_right, d_mount, d_clock)))
    }

    fn residual(&self, (a, b, c, d, right, mount, clock): Refs<'_, Self::Vars>) -> Option<SVector<f64, 6>> {
        let knots = Knots { poses: [a, b, c, d], times_s: self.left_times_s };
        let left = knots.at(clock.reference_time_s(self.right_time_s));
        self.mounted.residual((&left, right, mount))
    }
}
