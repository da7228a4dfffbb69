//! Focal lengths where neither the user nor EXIF nor the pairs tell them: tried, and judged by what
//! a small model explains.

use std::ops::ControlFlow;

use tiepoint_scene::{CameraId, CorrespondenceGraph, Reconstruction};

use super::explained::explained;
use super::growth::Mapper;
use crate::adjust::RefineIntrinsics;
use crate::options::MapperOptions;
use crate::two_view::with_focal;

/// Focal lengths that are tried where the pairs tell nothing, relative to the larger side of the
/// image: 127° to 26° of view.
const FOCAL_HYPOTHESES: [f64; 8] = [0.25, 0.35, 0.5, 0.65, 0.85, 1.2, 1.6, 2.2];
/// Images in the model that each of them is tried on.
const MAX_TRIAL_IMAGES: usize = 14;
/// A hypothesis must explain this much more than the guess does.
const MIN_TRIAL_GAIN: f64 = 1.05;

/// Where neither the user nor EXIF nor the pairs tell the focal length, as on a straight drive,
/// begins a model with each of several and keeps the one that explains the most. All such cameras
/// are given the same, relative to their images.
pub(super) fn choose_focal_lengths(
    graph: &CorrespondenceGraph,
    scene: &mut Reconstruction,
    options: &MapperOptions,
    found: &[CameraId],
) {
    let unknown: Vec<CameraId> = scene
        .cameras()
        .filter(|(id, camera)| !camera.has_focal_prior && !found.contains(id))
        .map(|(id, _)| id)
        .collect();
    if unknown.is_empty() {
        return;
    }
    let options = &MapperOptions { refine: RefineIntrinsics::NONE, ..*options };
    let explained = |scene: &Reconstruction| -> f64 {
        let mut mapper = Mapper::new(graph, scene, options);
        mapper.max_images = Some(MAX_TRIAL_IMAGES);
        // A hypothesis under which nothing can be begun explains nothing; what a failed trial has
        // reached counts.
        let watch = &mut |_: &_| ControlFlow::Continue(());
        let _ = mapper.initialise(&mapper.candidates(), watch).and_then(|_| mapper.grow(watch));
        explained(&mapper.solution.model).0
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
    let guess = explained(scene);
    let mut best = (MIN_TRIAL_GAIN * guess, scene.clone());
    for relative in FOCAL_HYPOTHESES {
        let candidate = with(scene, relative);
        if unknown.iter().all(|&id| candidate.camera(id) == scene.camera(id)) {
            continue; // The guess, which has been tried.
        }
        let score = explained(&candidate);
        if score > best.0 {
            best = (score, candidate);
        }
    }
    *scene = best.1;
}
