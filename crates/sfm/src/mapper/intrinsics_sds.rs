//! Standard deviations of the intrinsics of a finished model.

use std::collections::BTreeMap;

use tiepoint_adjust::{
    AdjustOptions, FitNoise, Scope, Term, build_problem, covariance_of_fit,
    without_points_at_infinity,
};
use tiepoint_ba::AnyKey;
use tiepoint_scene::{CameraId, Reconstruction};

/// Standard deviations of the parameters of each camera, in their order and units; 0 for constant
/// ones. The residuals of keypoints may be correlated ([`covariance_of_fit`]). Rigs are left out,
/// which makes the deviations a little larger. Empty if there is nothing to adjust or the normal
/// equations are singular.
pub(super) fn intrinsics_sds(
    model: &Reconstruction,
    options: &AdjustOptions,
    terms: &mut [&mut dyn Term],
) -> BTreeMap<CameraId, Vec<f64>> {
    let model = &without_points_at_infinity(model);
    let noise = FitNoise::of(model, &options.loss);
    let options = &AdjustOptions { noise: noise.sigma, select_tracks: false, ..*options };
    let Ok(variables) = build_problem(model, &Scope::Global, options, terms) else {
        return BTreeMap::new();
    };
    let (cameras, keys): (Vec<CameraId>, Vec<AnyKey>) = variables.intrinsics().unzip();
    let Ok(covariance) = covariance_of_fit(model, &variables, &noise, &keys) else {
        return BTreeMap::new();
    };
    let mut variances = covariance.diagonal().iter().copied().collect::<Vec<f64>>().into_iter();
    let of_camera = |camera: CameraId| {
        let count = model.camera(camera).intrinsics.kind().num_params();
        (camera, variances.by_ref().take(count).map(f64::sqrt).collect())
    };
    cameras.into_iter().map(of_camera).collect()
}
