//! Camera models that describe lenses better than the ones that a model has.
//!
//! A camera model with more distortion parameters always fits better: it takes a part of the field
//! of displacements that every lens leaves, and on a straight drive focal length and depths follow.
//! So two hypotheses are compared by how likely they make the distortion that fits best without a
//! field, as calibrations are ([`crate::calibration_evidence`]):
//!
//! - The lens is the one of the simpler model, and has a field.
//! - Each distortion parameter of the other model is off by its standard deviation, and the lens
//!   has a field.

use tiepoint_geometry::{CameraModelKind, Intrinsics};
use tiepoint_scene::{
    CameraId, IntrinsicsPrior, Observation, PointId, Reconstruction, Track, nearest_intrinsics,
};

use crate::Error;
use crate::field_effects::{field_effects, leave_images, num_modes};
use crate::infinity::without_points_at_infinity;
use crate::noise::FitNoise;
use crate::options::{AdjustOptions, Scope};
use crate::selection::select_points;
use crate::solve::{adjust, keep_going};

/// By how much each distortion parameter is off under the second hypothesis: it moves the border of
/// the image by a hundredth of its larger side. The rectilinear lenses of phones differ by as much,
/// action cameras by ten times more. The logarithm of the Bayes factor of a lens that differs
/// changes by its number of parameters times that of this number.
const RELATIVE_EFFECT: f64 = 0.01;

/// A camera model for the lens of a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct LensModel {
    /// The camera.
    pub camera: CameraId,
    /// The intrinsics that fit best.
    pub intrinsics: Intrinsics,
    /// Logarithm of the Bayes factor for this lens against the one that the camera has.
    pub log_bayes_factor: f64,
}

/// Fits other camera models to some cameras, and returns lenses whose logarithm of the Bayes factor
/// is above `least`, at most one for each camera: that of the fit with the best Bayesian
/// information criterion. Each of `kinds` describes the lenses of those before it, too: a camera is
/// fitted with those behind its own. Poses and points are free; other cameras, rigs and terms take
/// no part.
///
/// # Errors
///
/// If there is nothing to adjust.
pub fn better_lens_models(
    model: &Reconstruction,
    cameras: &[CameraId],
    kinds: &[CameraModelKind],
    least: f64,
    options: &AdjustOptions,
) -> Result<Vec<LensModel>, Error> {
    let mut model = selected(&without_points_at_infinity(model));
    let options = &AdjustOptions { select_tracks: false, ..*options };
    adjust(&mut model, &Scope::Global, options, &mut [], &mut keep_going)?;
    leave_undetermined(&mut model);
    let cost = adjust(&mut model, &Scope::Global, options, &mut [], &mut keep_going)?.final_cost;
    let mut fits = Vec::new();
    for (rank, &kind) in kinds.iter().enumerate() {
        let is_simpler =
            |id: &CameraId| kinds[..rank].contains(&model.camera(*id).intrinsics.kind());
        let simpler: Vec<CameraId> = cameras.iter().copied().filter(is_simpler).collect();
        if !simpler.is_empty() {
            // A camera model whose fit is undetermined is none for this lens.
            fits.extend(fit(&model, cost, &simpler, kind, options).unwrap_or_default());
        }
    }
    fits.sort_by(|one, other| other.gain.total_cmp(&one.gain));
    let best = |camera: CameraId| {
        let mut lenses = fits.iter().flat_map(|fit| &fit.lenses);
        lenses.find(|lens| lens.camera == camera && lens.log_bayes_factor > least).cloned()
    };
    Ok(cameras.iter().filter_map(|camera| best(*camera)).collect())
}

/// A fit of some cameras with one camera model.
struct Fit {
    /// How much better the information criterion is.
    gain: f64,
    lenses: Vec<LensModel>,
}

/// Fits all cameras with one camera model. `None` if the information criterion is not better.
fn fit(
    model: &Reconstruction,
    cost: f64,
    cameras: &[CameraId],
    kind: CameraModelKind,
    options: &AdjustOptions,
) -> Result<Option<Fit>, Error> {
    let mut model = model.clone();
    let mut expected: Vec<Option<IntrinsicsPrior>> = vec![None; model.cameras().count()];
    let mut num_more = 0;
    for &id in cameras {
        let camera = *model.camera(id);
        let (width, height) = (camera.width, camera.height);
        let Some(nearest) = nearest_intrinsics(&camera.intrinsics, kind, width, height) else {
            continue;
        };
        model.camera_mut(id).intrinsics = nearest;
        num_more += num_distortion(kind).saturating_sub(num_distortion(camera.intrinsics.kind()));
        let effect_px = RELATIVE_EFFECT * f64::from(width.max(height));
        expected[id.index()] = Some(IntrinsicsPrior::new(nearest, width, height, effect_px));
    }
    let fitted = adjust(&mut model, &Scope::Global, options, &mut [], &mut keep_going)?.final_cost;
    leave_undetermined(&mut model);
    let noise = FitNoise::of(&model, &options.loss);
    // The criterion knows of no fields, which explain a part of every gain.
    let num_more = num_more as f64;
    let gain = 2.0 * (cost - fitted) / noise.sigma.powi(2)
        - num_more * (2.0 * model.num_observations() as f64).ln();
    if gain <= 0.0 {
        return Ok(None);
    }
    let expected = |id: CameraId| expected[id.index()].as_ref();
    let effects = field_effects(&model, expected, options.refine, options, &noise)?;
    let modes = num_modes(cameras.len());
    let lenses = cameras.iter().filter_map(|&camera| {
        let effects = effects.of(|id, index| id == camera && is_distortion(kind, index))?;
        let log_bayes_factor = effects.log_bayes_factor(modes)?;
        let intrinsics = model.camera(camera).intrinsics;
        Some(LensModel { camera, intrinsics, log_bayes_factor })
    });
    Ok(Some(Fit { gain, lenses: lenses.collect() }))
}

/// Whether a parameter is one of the distortion.
fn is_distortion(kind: CameraModelKind, index: usize) -> bool {
    !kind.focal_indices().contains(&index)
        && !kind.principal_point_indices().contains(&index)
        && !kind.metadata_indices().contains(&index)
}

fn num_distortion(kind: CameraModelKind) -> usize {
    (0..kind.num_params()).filter(|index| is_distortion(kind, *index)).count()
}

/// Leaves out what would not be determined: points behind their cameras and at infinity, and images
/// with hardly any points.
fn leave_undetermined(model: &mut Reconstruction) {
    let is_projected =
        |it: &Observation, track: &Track| model.observation_error_px(it, &track.xyz).is_some();
    let unprojected: Vec<Observation> = model
        .tracks()
        .flat_map(|(_, track)| track.observations.iter().map(move |it| (*it, track)))
        .filter(|(it, track)| !is_projected(it, track))
        .map(|(it, _)| it)
        .collect();
    unprojected.into_iter().for_each(|observation| model.remove_observation(observation));
    leave_images(model);
    *model = without_points_at_infinity(model);
}

/// The images and points that determine lenses.
fn selected(model: &Reconstruction) -> Reconstruction {
    let mut model = model.clone();
    leave_images(&mut model);
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
