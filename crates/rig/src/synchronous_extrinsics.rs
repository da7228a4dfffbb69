//! Rig extrinsics as a variable: the relative pose at every frame equals them, up to a standard
//! deviation.
//!
//! With T = `cam_from_rig` = (R_T, t_T), c_T = −R_Tᵀ t_T the camera's centre in the rig frame,
//! which is the frame of the reference camera, and (c, R) the same of the poses at one frame, the
//! residual is ((c − c_T) / (|c_T| σ_t), Log(R R_Tᵀ) / σ_R). The translation error is relative to
//! the baseline |c_T|, which is differentiated as well. Shrinking the model, as a whole or where
//! clock errors scatter c, therefore does not lower the cost. Dividing by a constant instead lets
//! the model shrink. It is needed for cameras without common view, though: if only the motion
//! determines part of the baseline, a growing baseline would lower all other errors. With the
//! perturbations of CONVENTIONS.md, D = R R_Tᵀ, φ = Log D, e = c − c_T:
//!
//! | | reference (δ, τ) | cam (δ, τ) | T: δ | T: τ |
//! |---|---|---|---|---|
//! | c | see [`crate::RelativePose`] | see there | 0 | 0 |
//! | c_T | 0 | 0 | 0 | −R_Tᵀ |
//! | φ | −J_l⁻¹(φ) R, 0 | J_l⁻¹(φ), 0 | −J_l⁻¹(φ) D | 0 |
//!
//! and d(e/|c_T|) = (d c − d c_T)/|c_T| − e (c_T · d c_T)/|c_T|³, without the last term if a
//! constant replaces |c_T|.

use tiepoint_ba::Factor;
use tiepoint_ba::factor::{Linear, Refs};
use tiepoint_geometry::nalgebra::{Matrix3, SMatrix, SVector};
use tiepoint_geometry::{Rigid3, so3};

use crate::relative_pose::RelativePose;

/// Two cameras on one rig. Variables: `rig_from_world` and `cam_from_world` at one frame, and
/// the rig extrinsics `cam_from_rig`. Invalid if the baseline is zero and no baseline is
/// assumed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SynchronousExtrinsics {
    /// Standard deviation of each coordinate of the camera's centre in the rig, as a fraction of
    /// the baseline.
    pub sigma_translation: f64,
    /// Standard deviation of each component of the rotation, in radians.
    pub sigma_rotation_rad: f64,
    /// Baseline in model units, for cameras whose images do not determine it; `None` for that of
    /// the extrinsics.
    pub assumed_baseline: Option<f64>,
}

impl SynchronousExtrinsics {
    fn errors(
        &self,
        reference: &Rigid3,
        cam: &Rigid3,
        cam_from_rig: &Rigid3,
    ) -> Option<(SVector<f64, 6>, f64)> {
        let centre = *reference * cam.origin_in_a();
        let extrinsics_centre = cam_from_rig.origin_in_a();
        let baseline = self.assumed_baseline.unwrap_or_else(|| extrinsics_centre.norm());
        if baseline <= f64::MIN_POSITIVE {
            return None;
        }
        let rotation_error = so3::log(
            &(cam.rotation * reference.rotation.inverse() * cam_from_rig.rotation.inverse()),
        );
        let mut residual = SVector::<f64, 6>::zeros();
        residual
            .fixed_rows_mut::<3>(0)
            .copy_from(&((centre - extrinsics_centre) / (baseline * self.sigma_translation)));
        residual.fixed_rows_mut::<3>(3).copy_from(&(rotation_error / self.sigma_rotation_rad));
        Some((residual, baseline))
    }
}

impl Factor<6> for SynchronousExtrinsics {
    type Vars = (Rigid3, Rigid3, Rigid3);

    fn linearize(
        &self,
        (reference, cam, cam_from_rig): Refs<'_, Self::Vars>,
    ) -> Option<Linear<Self::Vars, 6>> {
        let (residual, baseline) = self.errors(reference, cam, cam_from_rig)?;
        let linear = RelativePose::linearize(reference, cam);
        let relative = matrix(&(cam.rotation * reference.rotation.inverse()));
        let (extrinsics_rotation, extrinsics_centre) =
            (matrix(&cam_from_rig.rotation), cam_from_rig.origin_in_a());
        let rotation_error = residual.fixed_rows::<3>(3) * self.sigma_rotation_rad;
        let inverse = so3::left_jacobian_inverse(&rotation_error) / self.sigma_rotation_rad;
        let scale = 1.0 / (baseline * self.sigma_translation);
        let mut d_reference = linear.d_reference * scale;
        let mut d_cam = linear.d_cam * scale;
        d_reference.fixed_rows_mut::<3>(3).fill(0.0);
        d_cam.fixed_rows_mut::<3>(3).fill(0.0);
        d_reference.fixed_view_mut::<3, 3>(3, 0).copy_from(&-(inverse * relative));
        d_cam.fixed_view_mut::<3, 3>(3, 0).copy_from(&inverse);
        // d r_t / d c_T, including the derivative of the baseline.
        let error = residual.fixed_rows::<3>(0) / scale;
        let by_baseline = match self.assumed_baseline {
            None => error * extrinsics_centre.transpose() / (baseline * baseline),
            Some(_) => Matrix3::zeros(),
        };
        let d_centre = -(Matrix3::identity() + by_baseline) * scale;
        let mut d_extrinsics = SMatrix::<f64, 6, 6>::zeros();
        let rig_from_cam = extrinsics_rotation.transpose();
        d_extrinsics.fixed_view_mut::<3, 3>(0, 3).copy_from(&(d_centre * -rig_from_cam));
        d_extrinsics.fixed_view_mut::<3, 3>(3, 0).copy_from(&-(inverse * relative * rig_from_cam));
        Some((residual, (d_reference, d_cam, d_extrinsics)))
    }

    fn residual(
        &self,
        (reference, cam, cam_from_rig): Refs<'_, Self::Vars>,
    ) -> Option<SVector<f64, 6>> {
        self.errors(reference, cam, cam_from_rig).map(|(residual, _)| residual)
    }
}

fn matrix(rotation: &tiepoint_geometry::nalgebra::UnitQuaternion<f64>) -> Matrix3<f64> {
    rotation.to_rotation_matrix().into_inner()
}
