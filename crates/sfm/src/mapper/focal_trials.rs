//! Selection of focal lengths by trial models, for cameras whose focal length neither the user nor
//! EXIF nor the image pairs determine.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use tiepoint_adjust::RefineIntrinsics;
use tiepoint_scene::{CameraId, CorrespondenceGraph, ImagePair, Reconstruction};

use super::growth::Growth;
use super::input::Input;
use super::start::support;
use crate::options::MapperOptions;
use crate::two_view::with_focal;

/// Trial focal lengths relative to the larger side of the image: fields of view of 127° to 26°.
const FOCAL_HYPOTHESES: [f64; 8] = [0.25, 0.35, 0.5, 0.65, 0.85, 1.2, 1.6, 2.2];
/// Number of images of a trial model.
const MAX_TRIAL_IMAGES: usize = 14;
/// Number of trial models of a hypothesis: of two cameras there are three kinds of pairs.
const MAX_TRIAL_MODELS: usize = 3;
/// Minimum ratio of a hypothesis' support to that of the initial guess.
const MIN_TRIAL_GAIN: f64 = 1.05;

/// Maps a small model with each trial focal length and keeps the one with the largest support. Used
/// where image pairs do not determine the focal length, as on a straight drive. All such cameras
/// get the same focal length relative to their image size.
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
    let options = &MapperOptions { refine: RefineIntrinsics::NONE, ..*options };
    let support = |scene: &Reconstruction| trial_support(Input::of_trial(graph, scene, options));
    let with = |scene: &Reconstruction, relative: f64| {
        let mut changed = scene.clone();
        for &id in &unknown {
            let camera = changed.camera_mut(id);
            let focal_px = relative * f64::from(camera.width.max(camera.height));
            camera.intrinsics = with_focal(&camera.intrinsics, focal_px);
        }
        changed
    };
    let guess = support(scene);
    let mut best = (MIN_TRIAL_GAIN * guess, scene.clone());
    for relative in FOCAL_HYPOTHESES {
        let candidate = with(scene, relative);
        if unknown.iter().all(|&id| candidate.camera(id) == scene.camera(id)) {
            continue; // The guess, which has been tried.
        }
        let score = support(&candidate);
        if score > best.0 {
            best = (score, candidate);
        }
    }
    *scene = best.1;
}

/// The largest support of trial models. A model that ends early tells of its initial pair, not of
/// the focal length: then another one begins with a pair of other cameras. On a highway the best
/// pairs are of two cameras side by side at one moment, and no third image has enough of their few
/// near points.
fn trial_support(input: Input) -> f64 {
    let blank = || Growth::trial(input, BTreeSet::new(), MAX_TRIAL_IMAGES);
    let cameras = |pair: &ImagePair| {
        let [a, b] = [pair.a, pair.b].map(|image| input.scene.image(image).camera);
        (a.min(b), a.max(b))
    };
    let mut candidates = blank().candidates();
    let mut most = 0.0_f64;
    for _ in 0..MAX_TRIAL_MODELS {
        let mut trial = blank();
        let watch = &mut |_: &_| ControlFlow::Continue(());
        // A hypothesis that cannot initialise a model has no support.
        let Ok(pair) = trial.initialise(&candidates, watch) else { break };
        // A failed trial counts with the images that it registered.
        let _ = trial.grow(watch);
        most = most.max(support(trial.model()).0);
        if trial.model().num_registered() >= MAX_TRIAL_IMAGES.min(input.graph.num_images()) {
            break;
        }
        let used = cameras(&pair);
        candidates.retain(|other| cameras(&other.pair) != used);
    }
    most
}
