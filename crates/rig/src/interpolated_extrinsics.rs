//! Rig extrinsics between images that were not taken at the same time.
//!
//! The residual is that of [`SynchronousExtrinsics`], with the pose of the reference camera
//! interpolated by [`Knots`] at the time that the other camera's clock maps to. The clock is a
//! variable as well. The interpolated pose is uncertain, because timestamps jitter and the motion
//! differs from the cubic. Its covariance is added to that of the residual: I + Σ g gᵀ. For a pose
//! of the other camera that agrees with the extrinsics, g is the residual after a perturbation of
//! the reference camera's pose by one standard deviation. The residual is whitened with this
//! covariance. Along the direction of motion the constraint is then as strong as the timestamps are
//! accurate, and across it as strong as the extrinsics are constant.

use tiepoint_ba::Factor;
use tiepoint_ba::factor::{Linear, Refs};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::{SMatrix, SVector, Vector2};

use crate::{Clock, Knots, SynchronousExtrinsics};

/// Two cameras on one rig. Variables: four consecutive `rig_from_world`, `cam_from_world`, the
/// rig extrinsics `cam_from_rig`, and the other camera's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InterpolatedExtrinsics {
    /// The constraint at one time, with its standard deviations.
    pub extrinsics: SynchronousExtrinsics,
    /// Times of the reference camera's four images on its clock, in seconds.
    pub reference_times_s: [f64; 4],
    /// Time of the other camera's image on its own clock, in seconds.
    pub image_time_s: f64,
    /// Inverse square root of the residual's covariance.
    pub whitening: SMatrix<f64, 6, 6>,
}

impl InterpolatedExtrinsics {
    /// Whitening at the interpolated pose `rig_from_world`, which is uncertain by
    /// `pose_perturbations`: motions of one standard deviation each.
    pub fn whitening(
        extrinsics: &SynchronousExtrinsics,
        rig_from_world: &Rigid3,
        cam_from_rig: &Rigid3,
        pose_perturbations: &[Rigid3],
    ) -> SMatrix<f64, 6, 6> {
        let cam = *cam_from_rig * *rig_from_world;
        let mut covariance = SMatrix::<f64, 6, 6>::identity();
        for perturbation in pose_perturbations {
            if let Some(g) =
                extrinsics.residual((&(*perturbation * *rig_from_world), &cam, cam_from_rig))
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
        (a, b, c, d, cam, cam_from_rig, clock): Refs<'_, Self::Vars>,
    ) -> Option<Linear<Self::Vars, 6>> {
        let knots = Knots { poses: [a, b, c, d], times_s: self.reference_times_s };
        let reference = knots.linearize(clock.reference_time_s(self.image_time_s));
        let (residual, (d_reference, d_cam, d_extrinsics)) =
            self.extrinsics.linearize((&reference.pose, cam, cam_from_rig))?;
        let w = &self.whitening;
        let d_reference = w * d_reference;
        let [a, b, c, d] = reference.d_knots.map(|d_knot| d_reference * d_knot);
        let d_time: SVector<f64, 6> = d_reference * reference.d_time;
        let d_time_by_clock = Vector2::new(1.0, self.image_time_s - clock.pivot_s);
        let d_clock: SMatrix<f64, 6, 2> = d_time * d_time_by_clock.transpose();
        Some((w * residual, (a, b, c, d, w * d_cam, w * d_extrinsics, d_clock)))
    }

    fn residual(
        &self,
        (a, b, c, d, cam, cam_from_rig, clock): Refs<'_, Self::Vars>,
    ) -> Option<SVector<f64, 6>> {
        let knots = Knots { poses: [a, b, c, d], times_s: self.reference_times_s };
        let reference = knots.at(clock.reference_time_s(self.image_time_s));
        self.extrinsics
            .residual((&reference, cam, cam_from_rig))
            .map(|residual| self.whitening * residual)
    }
}
