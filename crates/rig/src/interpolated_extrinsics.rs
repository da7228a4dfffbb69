//! Rig extrinsics between images that were not taken at the same time.
//!
//! The residual is that of [`SynchronousExtrinsics`], with the left pose interpolated by [`Knots`]
//! at the time that the right camera's clock maps to. The clock is a variable as well. The
//! interpolated pose is uncertain, because timestamps jitter and the motion differs from the cubic.
//! Its covariance is added to that of the residual: I + Σ g gᵀ, where g is the residual that a
//! perturbation of the left pose by one standard deviation causes for a right pose that agrees with
//! the extrinsics. The residual is whitened with this covariance. Along the direction of motion the
//! constraint is then as strong as the timestamps are accurate, and across it as strong as the
//! extrinsics are constant.

use tiepoint_ba::{Factor, Linear, Refs};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{SMatrix, SVector, Vector2};

use crate::{Clock, Knots, SynchronousExtrinsics};

/// Two cameras on one rig. Variables: four consecutive `left_from_world`, `right_from_world`, the
/// rig extrinsics `right_from_left`, and the right camera's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InterpolatedExtrinsics {
    /// The constraint at one time, with its standard deviations.
    pub extrinsics: SynchronousExtrinsics,
    /// Times of the four left images on the left camera's clock, in seconds.
    pub left_times_s: [f64; 4],
    /// Time of the right image on the right camera's clock, in seconds.
    pub right_time_s: f64,
    /// Inverse square root of the residual's covariance.
    pub whitening: SMatrix<f64, 6, 6>,
}

impl InterpolatedExtrinsics {
    /// Whitening at the interpolated pose `left_from_world`, which is uncertain by
    /// `pose_perturbations`: motions of one standard deviation each.
    pub fn whitening(
        extrinsics: &SynchronousExtrinsics,
        left_from_world: &Rigid3,
        right_from_left: &Rigid3,
        pose_perturbations: &[Rigid3],
    ) -> SMatrix<f64, 6, 6> {
        let right = *right_from_left * *left_from_world;
        let mut covariance = SMatrix::<f64, 6, 6>::identity();
        for perturbation in pose_perturbations {
            if let Some(g) =
                extrinsics.residual((&(*perturbation * *left_from_world), &right, right_from_left))
            {
                covariance += g * g.transpose();
            }
        }
        // Positive definite: the identity plus positive semidefinite terms.
        let root = covariance.cholesky().map(|cholesky| cholesky.l());
        root.and_then(|root| root.try_inverse()).unwrap_or_else(SMatrix::identity)
    }
}

impl Factor<6> for InterpolatedExtrinsics {
    type Vars = (Rigid3, Rigid3, Rigid3, Rigid3, Rigid3, Rigid3, Clock);

    fn linearize(
        &self,
        (a, b, c, d, right, right_from_left, clock): Refs<'_, Self::Vars>,
    ) -> Option<Linear<Self::Vars, 6>> {
        let knots = Knots { poses: [a, b, c, d], times_s: self.left_times_s };
        let left = knots.linearize(clock.reference_time_s(self.right_time_s));
        let (residual, (d_left, d_right, d_extrinsics)) =
            self.extrinsics.linearize((&left.pose, right, right_from_left))?;
        let w = &self.whitening;
        let d_left = w * d_left;
        let [a, b, c, d] = left.d_knots.map(|d_knot| d_left * d_knot);
        let d_time: SVector<f64, 6> = d_left * left.d_time;
        let d_time_by_clock = Vector2::new(1.0, self.right_time_s - clock.pivot_s);
        let d_clock: SMatrix<f64, 6, 2> = d_time * d_time_by_clock.transpose();
        Some((w * residual, (a, b, c, d, w * d_right, w * d_extrinsics, d_clock)))
    }

    fn residual(
        &self,
        (a, b, c, d, right, right_from_left, clock): Refs<'_, Self::Vars>,
    ) -> Option<SVector<f64, 6>> {
        let knots = Knots { poses: [a, b, c, d], times_s: self.left_times_s };
        let left = knots.at(clock.reference_time_s(self.right_time_s));
        self.extrinsics
            .residual((&left, right, right_from_left))
            .map(|residual| self.whitening * residual)
    }
}
