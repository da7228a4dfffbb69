//! How a camera is mounted, as a variable: the relative pose at every moment equals it, up to a
//! little play.
//!
//! With T = `right_from_left` = (R_T, t_T), c_T = −R_Tᵀ t_T the right camera's centre in the left
//! camera's frame, and (c, R) the same of the poses at one moment, the residual is ((c − c_T) /
//! (|c_T| σ_t), Log(R R_Tᵀ) / σ_R). The translation is measured in baselines, and the baseline is
//! differentiated with the rest: a model gains nothing by shrinking, neither as a whole nor where
//! the clocks scatter c. (Dividing by a constant instead lets it shrink. It is needed where cameras
//! see nothing in common, though: a baseline of which only the motion tells a part grows for as
//! long as that makes everything else small.) With the perturbations of CONVENTIONS.md, D = R R_Tᵀ,
//! φ = Log D, e = c − c_T:
//!
//! | | left (δ, τ) | right (δ, τ) | T: δ | T: τ |
//! |---|---|---|---|---|
//! | c | see [`crate::RelativePose`] | see there | 0 | 0 |
//! | c_T | 0 | 0 | 0 | −R_Tᵀ |
//! | φ | −J_l⁻¹(φ) R, 0 | J_l⁻¹(φ), 0 | −J_l⁻¹(φ) D | 0 |
//!
//! and d(e/|c_T|) = (d c − d c_T)/|c_T| − e (c_T · d c_T)/|c_T|³, the last part missing where a
//! constant stands for |c_T|.

use tiepoint_ba::{Factor, Linear, Refs};
use tiepoint_geometry::nalgebra::{Matrix3, SMatrix, SVector};
use tiepoint_geometry::{Rigid3, so3};

use crate::relative_pose::RelativePose;

/// Two cameras are mounted on one rig: variables `left_from_world` and `right_from_world` at one
/// moment, and `right_from_left`. Does not exist where the two centres of the mounting coincide and
/// no unit is given: then there is nothing to measure by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SynchronousExtrinsics {
    /// Standard deviation of each coordinate of the centre, in baselines or in the unit.
    pub sigma_translation: f64,
    /// Standard deviation of each component of the rotation, in radians.
    pub sigma_rotation_rad: f64,
    /// What stands for a baseline, in units of the model, where the images do not tell it.
    pub assumed_baseline: Option<f64>,
}

impl SynchronousExtrinsics {
    fn errors(
        &self,
        left: &Rigid3,
        right: &Rigid3,
        mount: &Rigid3,
    ) -> Option<(SVector<f64, 6>, f64)> {
        let centre = *left * right.origin_in_a();
        let mount_centre = mount.origin_in_a();
        let baseline = self.assumed_baseline.unwrap_or_else(|| mount_centre.norm());
        if baseline <= f64::MIN_POSITIVE {
            return None;
        }
        let turn = so3::log(&(right.rotation * left.rotation.inverse() * mount.rotation.inverse()));
        let mut residual = SVector::<f64, 6>::zeros();
        residual
            .fixed_rows_mut::<3>(0)
            .copy_from(&((centre - mount_centre) / (baseline * self.sigma_translation)));
        residual.fixed_rows_mut::<3>(3).copy_from(&(turn / self.sigma_rotation_rad));
        Some((residual, baseline))
    }
}

impl Factor<6> for SynchronousExtrinsics {
    type Vars = (Rigid3, Rigid3, Rigid3);

    fn linearize(
        &self,
        (left, right, mount): Refs<'_, Self::Vars>,
    ) -> Option<Linear<Self::Vars, 6>> {
        let (residual, baseline) = self.errors(left, right, mount)?;
        let linear = RelativePose::linearize(left, right);
        let relative = matrix(&(right.rotation * left.rotation.inverse()));
        let (mount_rotation, mount_centre) = (matrix(&mount.rotation), mount.origin_in_a());
        let turn = residual.fixed_rows::<3>(3) * self.sigma_rotation_rad;
        let inverse = so3::left_jacobian_inverse(&turn) / self.sigma_rotation_rad;
        let scale = 1.0 / (baseline * self.sigma_translation);
        let mut d_left = linear.d_left * scale;
        let mut d_right = linear.d_right * scale;
        d_left.fixed_rows_mut::<3>(3).fill(0.0);
        d_right.fixed_rows_mut::<3>(3).fill(0.0);
        d_left.fixed_view_mut::<3, 3>(3, 0).copy_from(&-(inverse * relative));
        d_right.fixed_view_mut::<3, 3>(3, 0).copy_from(&inverse);
        // d r_t / d c_T, with the baseline's part.
        let error = residual.fixed_rows::<3>(0) / scale;
        let by_baseline = match self.assumed_baseline {
            None => error * mount_centre.transpose() / (baseline * baseline),
            Some(_) => Matrix3::zeros(),
        };
        let d_centre = -(Matrix3::identity() + by_baseline) * scale;
        let mut d_mount = SMatrix::<f64, 6, 6>::zeros();
        let turned = mount_rotation.transpose();
        d_mount.fixed_view_mut::<3, 3>(0, 3).copy_from(&(d_centre * -turned));
        d_mount.fixed_view_mut::<3, 3>(3, 0).copy_from(&-(inverse * relative * turned));
        Some((residual, (d_left, d_right, d_mount)))
    }

    fn residual(&self, (left, right, mount): Refs<'_, Self::Vars>) -> Option<SVector<f64, 6>> {
        self.errors(left, right, mount).map(|(residual, _)| residual)
    }
}

fn matrix(rotation: &tiepoint_geometry::nalgebra::UnitQuaternion<f64>) -> Matrix3<f64> {
    rotation.to_rotation_matrix().into_inner()
}
