//! Whether the images contradict a calibration.
//!
//! A lens model leaves a smooth static field of displacements, 0.1 to 0.2 px on KITTI (Krešo and
//! Šegvić 2015). Intrinsics that are refined fit a part of it. On a straight drive they then move
//! by ten pixels for a gain of 1 % in the reprojection error, and the trajectory becomes worse. So
//! two hypotheses are compared by how likely they make the intrinsics that fit best without a
//! field:
//!
//! - The calibration is exact, and the lens has a field.
//! - Each parameter is off by its standard deviation, and the lens has a field.
//!
//! The field is a bicubic spline whose coefficients have independent normal distributions of one
//! standard deviation τ. τ is estimated from the field that residuals show after a refinement of
//! the intrinsics ([`RandomEffects`]).

use tiepoint_scene::{CameraId, IntrinsicsPrior, Reconstruction};

use crate::Error;
use crate::field_effects::{cameras_with_fields, field_effects, fit_poses, num_modes};
use crate::infinity::without_points_at_infinity;
use crate::intrinsics::fixed_columns;
use crate::noise::FitNoise;
use crate::options::{AdjustOptions, RefineIntrinsics};

/// What images say of calibrations.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CalibrationEvidence {
    /// Logarithm of the Bayes factor for intrinsics that are off by the standard deviations of
    /// their calibrations, against exact ones. `None` if no camera has a calibration that is
    /// refined and enough images.
    pub log_bayes_factor: Option<f64>,
    /// The cameras that it is of.
    pub cameras: Vec<CameraId>,
}

/// Compares exact calibrations with wrong ones. The model was refined with the calibrations as
/// priors. Poses are free, whatever rigs or terms say of them; cameras that are not compared are
/// constant.
///
/// # Errors
///
/// If a variable is undetermined, or there is nothing to adjust.
pub fn calibration_evidence(
    model: &Reconstruction,
    options: &AdjustOptions,
) -> Result<CalibrationEvidence, Error> {
    let refine = options.refine_calibrated.unwrap_or(options.refine);
    let cameras = calibrated_cameras(model, refine);
    if cameras.is_empty() {
        return Ok(CalibrationEvidence::default());
    }
    let mut model = without_points_at_infinity(model);
    let noise = FitNoise::of(&model, &options.loss);
    fit_poses(&mut model, options)?;
    let expected = |id| cameras.contains(&id).then(|| &model.intrinsics_priors[&id]);
    let effects = field_effects(&model, expected, refine, options, &noise)?.all();
    let modes = num_modes(cameras.len());
    let log_bayes_factor = effects.and_then(|effects| effects.log_bayes_factor(modes));
    Ok(CalibrationEvidence { log_bayes_factor, cameras })
}

/// Cameras whose calibrations are tested, in order of their ids.
fn calibrated_cameras(model: &Reconstruction, refine: RefineIntrinsics) -> Vec<CameraId> {
    let is_tested = |(camera, prior): &(&CameraId, &IntrinsicsPrior)| {
        let kind = model.camera(**camera).intrinsics.kind();
        !model.calibrated.contains(camera)
            && prior.mean.kind() == kind
            && fixed_columns(kind, refine).len() < kind.num_params()
    };
    let tested = model.intrinsics_priors.iter().filter(is_tested).map(|(camera, _)| *camera);
    cameras_with_fields(model, tested)
}
