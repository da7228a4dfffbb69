//! Intrinsics of cameras without a calibration, by a fit with lens fields.
//!
//! On a straight drive only effects of second order determine a focal length, a tenth of a pixel
//! for a tenth of its value, and the field of displacements that a lens model leaves is as large.
//! Without a field in the model the focal length follows it: on KITTI 04 it ends 5 to 23 % short,
//! at 1.2 to 7.5 of its cluster-robust standard deviations. Here the field is a part of the
//! fit, a random effect whose variance is that of the field in the residuals.

use tiepoint_ba::{AnyKey, Options, Solver};
use tiepoint_geometry::Intrinsics;
use tiepoint_geometry::nalgebra::DMatrix;
use tiepoint_scene::{CameraId, IntrinsicsPrior, Reconstruction};

use crate::Error;
use crate::covariance::clustered_by_track_and_cell;
use crate::field_effects::{field_effects, fit_poses, num_modes};
use crate::field_problem::{FieldPriors, FieldProblem};
use crate::infinity::without_points_at_infinity;
use crate::noise::FitNoise;
use crate::options::AdjustOptions;

/// Standard deviation of a field that residuals do not show: a prior cannot have none.
const MIN_FIELD_PX: f64 = 1e-3;

/// Intrinsics of a camera by a fit with lens fields.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldFit {
    /// The camera.
    pub camera: CameraId,
    /// Its intrinsics.
    pub intrinsics: Intrinsics,
    /// Standard deviations of the parameters, in their order and units; 0 for constant ones.
    pub sds: Vec<f64>,
}

/// Estimates the intrinsics of some cameras together with poses, points and a lens field for each
/// of them, which is a bicubic spline whose coefficients have independent normal distributions of
/// one variance. Rigs and terms are left out, and other cameras are constant. The standard
/// deviations are cluster-robust ([`crate::covariance_of_fit`]). Empty if the images do not
/// determine that variance, or the fit does not converge.
///
/// # Errors
///
/// If a variable is undetermined, or there is nothing to adjust.
pub fn fit_with_lens_fields(
    model: &Reconstruction,
    cameras: &[CameraId],
    options: &AdjustOptions,
) -> Result<Vec<FieldFit>, Error> {
    let mut model = without_points_at_infinity(model);
    let noise = FitNoise::of(&model, &options.loss);
    fit_poses(&mut model, options)?;
    let refine = options.refine;
    let is_fitted = |id: CameraId| cameras.contains(&id);
    let expected: Vec<Option<IntrinsicsPrior>> = model
        .cameras()
        .map(|(id, camera)| {
            is_fitted(id)
                .then(|| IntrinsicsPrior::new(camera.intrinsics, camera.width, camera.height, 1.0))
        })
        .collect();
    let expected = |id: CameraId| expected[id.index()].as_ref();
    let effects = field_effects(&model, expected, refine, options, &noise)?.all();
    let modes = num_modes(cameras.len());
    let Some(variance) = effects.and_then(|effects| effects.variance(modes)) else {
        return Ok(Vec::new());
    };
    let options = &AdjustOptions { noise: noise.sigma, ..*options };
    let field_px = variance.sqrt().max(MIN_FIELD_PX);
    let mut scene = FieldProblem::new(&model, options.loss, |id| {
        is_fitted(id).then_some(FieldPriors { refine, intrinsics: None, field_px, options })
    })?;
    let solver_options = Options {
        max_iterations: options.max_iterations,
        function_tolerance: options.function_tolerance,
        ..Options::default()
    };
    let summary = Solver::new(&scene.problem, &solver_options)?.solve(&mut scene.problem)?;
    if !summary.termination.converged() {
        return Ok(Vec::new());
    }
    let keys: Vec<AnyKey> = scene.cameras.iter().map(|camera| camera.intrinsics).collect();
    scene.cells.sort_unstable();
    let covariance: DMatrix<f64> =
        clustered_by_track_and_cell(&scene.problem, &scene.cells, &noise, &keys)?;
    let mut variances = covariance.diagonal().iter().copied().collect::<Vec<f64>>().into_iter();
    let fits = scene.cameras.iter().map(|camera| {
        let mut intrinsics = model.camera(camera.camera).intrinsics;
        intrinsics.params_mut().copy_from_slice(&(camera.read)(&scene.problem));
        let sds = variances.by_ref().take(camera.params.len()).map(f64::sqrt).collect();
        FieldFit { camera: camera.camera, intrinsics, sds }
    });
    Ok(fits.collect())
}
