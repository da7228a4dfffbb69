//! Camera models that describe the lenses of a model better than its own.
//!
//! A camera model with more distortion parameters always fits better: it takes a part of the field
//! of displacements that every lens leaves, and on a straight drive focal length and depths follow.
//! So two hypotheses are compared by how likely they make the distortion that fits best without a
//! field, as calibrations are ([`crate::calibration_evidence`]):
//!
//! - The lens is the one of the other camera model that is nearest to the present one, and has a
//!   field.
//! - Each distortion parameter differs from that one by its standard deviation, and the lens has a
//!   field.

use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_scene::{
    CameraId, IntrinsicsPrior, Observation, PointId, Reconstruction, Track, nearest_intrinsics,
};

use crate::Error;
use crate::field_effects::{field_effects, leave_out_weak_images, num_modes};
use crate::infinity::without_points_at_infinity;
use crate::noise::FitNoise;
use crate::options::{AdjustOptions, Scope};
use crate::selection::select_points;
use crate::solve::{adjust, keep_going};

/// Standard deviation of each distortion parameter under the second hypothesis, by its effect: it
/// moves the projection of some ray at the border of the image by this part of the larger side. An
/// assumption, not varied: where images determine a parameter, twice the value lowers the logarithm
/// of the Bayes factor by ln 2.
const RELATIVE_EFFECT: f64 = 0.01;

/// A camera model that describes the lens of a camera better.
#[derive(Clone, Debug, PartialEq)]
pub struct BetterCameraModel {
    /// The camera.
    pub camera: CameraId,
    /// The intrinsics that fit best.
    pub intrinsics: Intrinsics,
    /// Logarithm of the Bayes factor for this lens against the one that the camera has.
    pub log_bayes_factor: f64,
}

/// Fits other camera models to some cameras, and returns those whose logarithm of the Bayes factor
/// is above `least`, at most one for each camera: of the fit with the best Bayesian information
/// criterion. The criterion is one of all cameras; it must decrease by more than twice `least`.
/// Each of `kinds` describes the lenses of those before it, at least nearly: a camera is fitted
/// with those behind its own. Poses, points and the intrinsics of other cameras are free as the
/// options say; rigs and terms take no part.
///
/// # Errors
///
/// If there are cameras to fit and nothing to adjust.
pub fn better_camera_models(
    model: &Reconstruction,
    cameras: &[CameraId],
    kinds: &[CameraModelKind],
    least: f64,
    options: &AdjustOptions,
) -> Result<Vec<BetterCameraModel>, Error> {
    let with_simpler = |(rank, &kind): (usize, &CameraModelKind)| {
        let is_simpler =
            |id: &CameraId| kinds[..rank].contains(&model.camera(*id).intrinsics.kind());
        let mut simpler: Vec<CameraId> = cameras.iter().copied().filter(is_simpler).collect();
        // The gain of a camera with fewer parameters would decide for one with as many.
        let has_fewer = |id: &CameraId| {
            num_distortion(model.camera(*id).intrinsics.kind()) < num_distortion(kind)
        };
        if simpler.iter().any(has_fewer) {
            simpler.retain(has_fewer);
        }
        (kind, simpler)
    };
    let mut trials: Vec<(CameraModelKind, Vec<CameraId>)> =
        kinds.iter().enumerate().map(with_simpler).collect();
    trials.retain(|(_, simpler)| !simpler.is_empty());
    if trials.is_empty() {
        return Ok(Vec::new());
    }
    let mut model = selected(without_points_at_infinity(model));
    let options = &AdjustOptions { select_tracks: false, ..*options };
    adjust(&mut model, &Scope::Global, options, &mut [], &mut keep_going)?;
    leave_out_undetermined(&mut model);
    let cost = adjust(&mut model, &Scope::Global, options, &mut [], &mut keep_going)?.final_cost;
    // A camera model whose fit is undetermined is none for this lens.
    let fitted =
        |(kind, simpler)| fit(&model, cost, simpler, kind, least, options).unwrap_or_default();
    let mut fits: Vec<Fit> =
        trials.iter().map(|(kind, simpler)| (*kind, &simpler[..])).filter_map(fitted).collect();
    fits.sort_by(|one, other| other.gain.total_cmp(&one.gain));
    let best = |camera: CameraId| {
        let mut found = fits.iter().flat_map(|fit| &fit.cameras);
        found.find(|it| it.camera == camera && it.log_bayes_factor > least).cloned()
    };
    Ok(cameras.iter().filter_map(|camera| best(*camera)).collect())
}

fn num_distortion(kind: CameraModelKind) -> usize {
    kind.distortion_indices().len()
}

/// A fit of some cameras with one camera model.
struct Fit {
    /// Decrease of the information criterion.
    gain: f64,
    cameras: Vec<BetterCameraModel>,
}

/// Fits all cameras with one camera model. `None` if the information criterion says that the
/// logarithm of the Bayes factor is at most `least`: nothing else compares the other camera model
/// with the present one where it has no more parameters.
fn fit(
    model: &Reconstruction,
    cost: f64,
    cameras: &[CameraId],
    kind: CameraModelKind,
    least: f64,
    options: &AdjustOptions,
) -> Result<Option<Fit>, Error> {
    let mut model = model.clone();
    let mut expected: Vec<Option<IntrinsicsPrior>> = vec![None; model.cameras().count()];
    let distortion = kind.distortion_indices();
    let mut num_more = 0;
    for &id in cameras {
        let camera = *model.camera(id);
        let (width, height) = (camera.width, camera.height);
        let Some(nearest) = nearest_intrinsics(&camera.intrinsics, kind, width, height) else {
            continue;
        };
        model.camera_mut(id).intrinsics = nearest;
        num_more += distortion.len().saturating_sub(num_distortion(camera.intrinsics.kind()));
        let effect_px = RELATIVE_EFFECT * f64::from(width.max(height));
        expected[id.index()] = Some(IntrinsicsPrior::new(nearest, width, height, effect_px));
    }
    let fitted = adjust(&mut model, &Scope::Global, options, &mut [], &mut keep_going)?.final_cost;
    leave_out_undetermined(&mut model);
    let noise = FitNoise::of(&model, &options.loss);
    // The criterion knows of no fields, which explain a part of every gain.
    let num_more = num_more as f64;
    let gain = 2.0 * (cost - fitted) / noise.sigma.powi(2)
        - num_more * (2.0 * model.num_observations() as f64).ln();
    if gain <= 2.0 * least {
        return Ok(None);
    }
    let expected = |id: CameraId| expected[id.index()].as_ref();
    let effects = field_effects(&model, expected, options.refine, options, &noise)?;
    let modes = num_modes(cameras.len());
    let found = cameras.iter().filter_map(|&camera| {
        let effects = effects.of(|id, index| id == camera && distortion.contains(&index))?;
        let log_bayes_factor = effects.log_bayes_factor(modes)?;
        let intrinsics = model.camera(camera).intrinsics;
        Some(BetterCameraModel { camera, intrinsics, log_bayes_factor })
    });
    Ok(Some(Fit { gain, cameras: found.collect() }))
}

/// Leaves out what would not be determined: points behind their cameras and at infinity, and images
/// with hardly any points.
fn leave_out_undetermined(model: &mut Reconstruction) {
    let is_projected =
        |it: &Observation, track: &Track| model.observation_error_px(it, &track.xyz).is_some();
    let unprojected: Vec<Observation> = model
        .tracks()
        .flat_map(|(_, track)| track.observations.iter().map(move |it| (*it, track)))
        .filter(|(it, track)| !is_projected(it, track))
        .map(|(it, _)| it)
        .collect();
    unprojected.into_iter().for_each(|observation| model.remove_observation(observation));
    leave_out_weak_images(model);
    *model = without_points_at_infinity(model);
}

/// The images and points that determine lenses.
fn selected(mut model: Reconstruction) -> Reconstruction {
    leave_out_weak_images(&mut model);
    let points: Vec<PointId> = model.tracks().map(|(id, _)| id).collect();
    let is_trained = |id: &PointId| model.track(*id).is_some_and(|track| !track.is_held_out);
    let trained = points.iter().copied().filter(is_trained).collect();
    let kept = select_points(&model, trained, |_| true);
    for point in points {
        if kept.binary_search(&point).is_err() {
            model.delete_track(point);
        }
    }
    model
}
