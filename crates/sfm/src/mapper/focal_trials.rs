//! Selection of focal lengths by trial models, for cameras whose focal length neither the user nor
//! EXIF nor the image pairs determine.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use tiepoint_adjust::RefineIntrinsics;
use tiepoint_scene::{CameraId, CorrespondenceGraph, Reconstruction};

use super::growth::Growth;
use super::input::Input;
use super::support::support;
use crate::options::MapperOptions;
use crate::two_view::with_focal;

/// Trial focal lengths relative to the larger side of the image: fields of view of 127° to 26°.
const FOCAL_HYPOTHESES: [f64; 8] = [0.25, 0.35, 0.5, 0.65, 0.85, 1.2, 1.6, 2.2];
/// Number of images of a trial model.
const MAX_TRIAL_IMAGES: usize = 14;
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
    let support = |scene: &Reconstruction| -> f64 {
        let input = Input::of_trial(graph, scene, options);
        let mut trial = Growth::trial(input, BTreeSet::new(), MAX_TRIAL_IMAGES);
        // A hypothesis that cannot initialise a model has no support. A failed trial counts with
        // the images that it registered.
        let watch = &mut |_: &_| ControlFlow::Continue(());
        let _ = trial.initialise(&trial.candidates(), watch).and_then(|_| trial.grow(watch));
        support(trial.model()).0
    };
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
