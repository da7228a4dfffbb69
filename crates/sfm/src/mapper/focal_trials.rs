//! Selection of focal lengths by trial models, for cameras whose focal length neither the user nor
//! EXIF nor the image pairs determine.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use tiepoint_adjust::RefineIntrinsics;
use tiepoint_scene::{CameraId, CorrespondenceGraph, ImagePair, Reconstruction};

use super::growth::Growth;
use super::input::Input;
use super::refinement_schedule::RefinementSchedule;
use super::refiner::Refiner;
use super::start::support;
use crate::options::MapperOptions;
use crate::two_view::with_focal;

/// Trial focal lengths relative to the larger side of the image: fields of view of 127° to 26°.
const FOCAL_HYPOTHESES: [f64; 8] = [0.25, 0.35, 0.5, 0.65, 0.85, 1.2, 1.6, 2.2];
/// Number of images of a trial model.
const MAX_TRIAL_IMAGES: usize = 14;
/// Number of trial models of a hypothesis: of two cameras there are three kinds of pairs.
const MAX_TRIAL_MODELS: usize = 3;
/// Minimum ratio of a hypothesis' support to that of the initial guess, and of the mean support of
/// a refined hypothesis to that of the chosen one. On 12 rendered straight drives
/// (docs/benchmarks/drives.md) no refined hypothesis has more than 1.04 times that of any other
/// one, so that half of the gain may change something on them. Of a street at 2.5 Hz whose focal
/// length ended far off it is 1.11, and double would be near to missing that.
const MIN_TRIAL_GAIN: f64 = 1.05;

/// What a trial tells of a focal length.
struct Trial {
    /// The scene with the focal length.
    scene: Reconstruction,
    /// The support of the model with this focal length.
    support: f64,
    /// The model after its intrinsics were refined; `None` if that fails.
    refined: Option<Refined>,
}

/// A trial model with refined intrinsics.
#[derive(Clone, Copy)]
struct Refined {
    num_images: usize,
    /// Mean support of an observation.
    mean_support: f64,
    /// Mean focal length relative to the larger side of the image.
    relative_focal: f64,
}

/// Maps a small model with each trial focal length and keeps the one with the largest support. Used
/// where image pairs do not determine the focal length, as on a straight drive. All such cameras
/// get the same focal length relative to their image size.
///
/// The support of a model tells how much its images see, too. So the intrinsics of each model are
/// refined, and where one explains its observations much better than the chosen one, its refined
/// focal length is taken: from a wrong one, a model of few images does not reach it.
pub(super) fn choose_focal_lengths(
    graph: &CorrespondenceGraph,
    scene: &mut Reconstruction,
    options: &MapperOptions,
    found: &[CameraId],
) {
    let unknown: Vec<CameraId> = scene
        .cameras()
        .filter(|(id, camera)| !camera.is_calibrated() && !found.contains(id))
        .map(|(id, _)| id)
        .collect();
    if unknown.is_empty() {
        return;
    }
    let held = &MapperOptions { refine: RefineIntrinsics::NONE, ..*options };
    let trial = |scene: Reconstruction| {
        let (support, model) = trial_model(Input::of_trial(graph, &scene, held));
        let refined = model.and_then(|model| refined(graph, &scene, options, model, &unknown));
        Trial { scene, support, refined }
    };
    let guess = trial(scene.clone());
    let mut best = MIN_TRIAL_GAIN * guess.support;
    let (mut chosen, mut trials) = (0, vec![guess]);
    for relative in FOCAL_HYPOTHESES {
        let candidate = with_relative_focal(scene, &unknown, relative);
        if unknown.iter().all(|&id| candidate.camera(id) == scene.camera(id)) {
            continue; // The guess, which has been tried.
        }
        let trial = trial(candidate);
        if trial.support > best {
            (best, chosen) = (trial.support, trials.len());
        }
        trials.push(trial);
    }
    *scene = trials[chosen].scene.clone();
    let Some(of_chosen) = trials[chosen].refined else { return };
    let refined = trials.iter().filter_map(|trial| trial.refined);
    let as_large = refined.filter(|refined| refined.num_images >= of_chosen.num_images);
    if let Some(better) = as_large.max_by(|a, b| a.mean_support.total_cmp(&b.mean_support))
        && better.mean_support > MIN_TRIAL_GAIN * of_chosen.mean_support
    {
        *scene = with_relative_focal(scene, &unknown, better.relative_focal);
    }
}

/// The scene with one focal length, relative to the larger side of the image, for some cameras.
fn with_relative_focal(
    scene: &Reconstruction,
    cameras: &[CameraId],
    relative: f64,
) -> Reconstruction {
    let mut changed = scene.clone();
    for &id in cameras {
        let camera = changed.camera_mut(id);
        let focal_px = relative * f64::from(camera.width.max(camera.height));
        camera.intrinsics = with_focal(&camera.intrinsics, focal_px);
    }
    changed
}

/// Refines a trial model with its intrinsics ([`Trial::refined`]).
fn refined(
    graph: &CorrespondenceGraph,
    scene: &Reconstruction,
    options: &MapperOptions,
    model: Reconstruction,
    unknown: &[CameraId],
) -> Option<Refined> {
    let refine = RefineIntrinsics { principal_point: false, ..options.refine };
    let options = &MapperOptions { refine, ..*options };
    let mut refiner = Refiner::new(Input::of_trial(graph, scene, options), model, Vec::new());
    refiner.complete();
    let watch = &mut |_: &_| ControlFlow::Continue(());
    refiner.refine_globally(&RefinementSchedule::GROWING, watch).ok()?;
    let model = &refiner.solution.model;
    let cameras = model.registered_cameras();
    let cameras = unknown.iter().filter(|id| cameras.contains(id)).map(|id| model.camera(*id));
    let focals: Vec<f64> = cameras
        .map(|camera| {
            camera.intrinsics.mean_focal_px() / f64::from(camera.width.max(camera.height))
        })
        .collect();
    let relative_focal = focals.iter().sum::<f64>() / focals.len() as f64;
    let [shortest, .., longest] = FOCAL_HYPOTHESES;
    let (_, mean_support) = support(model);
    (shortest..=longest).contains(&relative_focal).then(|| Refined {
        num_images: model.num_registered(),
        mean_support,
        relative_focal,
    })
}

/// The trial model with the largest support, and that. A model that ends early tells of its initial
/// pair, not of the focal length: then another one begins with a pair of other cameras. On a
/// highway the best pairs are of two cameras side by side at one moment, and no third image has
/// enough of their few near points.
fn trial_model(input: Input) -> (f64, Option<Reconstruction>) {
    let blank = || Growth::trial(input, BTreeSet::new(), MAX_TRIAL_IMAGES);
    let cameras = |pair: &ImagePair| {
        let [a, b] = [pair.a, pair.b].map(|image| input.scene.image(image).camera);
        (a.min(b), a.max(b))
    };
    let mut candidates = blank().candidates();
    let mut most = (0.0, None);
    for _ in 0..MAX_TRIAL_MODELS {
        let mut trial = blank();
        let watch = &mut |_: &_| ControlFlow::Continue(());
        // A hypothesis that cannot initialise a model has no support.
        let Ok(pair) = trial.initialise(&candidates, watch) else { break };
        // A failed trial counts with the images that it registered.
        let _ = trial.grow(watch);
        let (score, _) = support(trial.model());
        if score > most.0 {
            most = (score, Some(trial.model().clone()));
        }
        if trial.model().num_registered() >= MAX_TRIAL_IMAGES.min(input.graph.num_images()) {
            break;
        }
        let used = cameras(&pair);
        candidates.retain(|other| cameras(&other.pair) != used);
    }
    most
}
