//! A mounting held between images of two cameras that were not taken at one instant.
//!
//! The residual is that of [`SynchronousExtrinsics`] with the left camera's pose interpolated
//! ([`Knots`]) at the time that the right camera's clock gives it: the clock is a variable too, and
//! the chain rule does the rest. What is doubtful about an interpolated pose (stamps that jitter,
//! motion that the cubic cannot know) is part of the residual's covariance, I + Σ g gᵀ with g what
//! each perturbation does to the residual of a right camera that is exactly where the mounting has
//! it; the residual is whitened with it, so that along the way the mounting holds as firmly as the
//! stamps deserve, and across it as firmly as the mount.

use tiepoint_ba::{Factor, Linear, Refs};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{SMatrix, SVector, Vector2};

use crate::{Clock, Knots, SynchronousExtrinsics};

/// Two cameras are mounted on one rig: variables four consecutive `left_from_world`, one
/// `right_from_world`, `right_from_left`, and the right camera's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InterpolatedExtrinsics {
    /// How firmly.
    pub mounted: SynchronousExtrinsics,
    /// When the four left images were taken, on the left camera's clock.
    pub left_times_s: [f64; 4],
    /// When the right image was taken, on its own clock.
    pub right_time_s: f64,
    /// What the residual is multiplied by: the inverse of a root of its covariance.
    pub whitening: SMatrix<f64, 6, 6>,
}

impl InterpolatedExtrinsics {
    /// The whitening where the left camera is at `left_from_world`, and may be off by each of
    /// `pose_perturbations`, motions of one standard deviation.
    pub fn whitening(
        mounted: &SynchronousExtrinsics,
        left_from_world: &Rigid3,
        right_from_left: &Rigid3,
        pose_perturbations: &[Rigid3],
    ) -> SMatrix<f64, 6, 6> {
        let right = *right_from_left * *left_from_world;
        let mut covariance = SMatrix::<f64, 6, 6>::identity();
        for perturbation in pose_perturbations {
            if let Some(g) =
                mounted.residual((&(*perturbation * *left_from_world), &right, right_from_left))
            {
                covariance += g * g.transpose();
            }
        }
        // It is an identity with something positive on top.
        let root = covariance.cholesky().map(|cholesky| cholesky.l());
        root.and_then(|root| root.try_inverse()).unwrap_or_else(SMatrix::identity)
    }
}

impl Factor<6> for InterpolatedExtrinsics {
    type Vars = (Rigid3, Rigid3, Rigid3, Rigid3, Rigid3, Rigid3, Clock);

    fn linearize(
        &self,
        (a, b, c, d, right, mount, clock): Refs<'_, Self::Vars>,
    ) -> Option<Linear<Self::Vars, 6>> {
        let knots = Knots { poses: [a, b, c, d], times_s: self.left_times_s };
        let left = knots.linearize(clock.reference_time_s(self.right_time_s));
        let (residual, (d_left, d_right, d_mount)) =
            self.mounted.linearize((&left.pose, right, mount))?;
        let w = &self.whitening;
        let d_left = w * d_left;
        let [a, b, c, d] = left.d_knots.map(|d_knot| d_left * d_knot);
        let d_time: SVector<f64, 6> = d_left * left.d_time;
        let by_clock = Vector2::new(1.0, self.right_time_s - clock.pivot_s);
        let d_clock: SMatrix<f64, 6, 2> = d_time * by_clock.transpose();
        Some((w * residual, (a, b, c, d, w * d_right, w * d_mount, d_clock)))
    }

    fn residual(
        &self,
        (a, b, c, d, right, mount, clock): Refs<'_, Self::Vars>,
    ) -> Option<SVector<f64, 6>> {
        let knots = Knots { poses: [a, b, c, d], times_s: self.left_times_s };
        let left = knots.at(clock.reference_time_s(self.right_time_s));
        self.mounted.residual((&left, right, mount)).map(|residual| self.whitening * residual)
    }
}
