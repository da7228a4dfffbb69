//! One model for each connected component of the image graph.

use std::collections::BTreeSet;

use tiepoint_adjust::{FocalPrior, Term};
use tiepoint_scene::{CorrespondenceGraph, ImageId, Reconstruction};

use super::checkpoint::{Checkpoints, Step};
use super::focal_trials::choose_focal_lengths;
use super::growth::Growth;
use super::input::Input;
use super::join::registered;
use super::refiner::Refiner;
use crate::Error;
use crate::event::Watch;
use crate::mapped_model::MappedModel;
use crate::options::MapperOptions;
use crate::rigs::Descriptors;
use crate::terms::reborrow;
use crate::two_view::{estimate_focal_lengths, focal_priors};

/// The scene without poses, points and rigs.
pub(super) fn without_model(scene: &Reconstruction) -> Reconstruction {
    let mut scene = scene.clone();
    (scene.rigs, scene.frames) = (Vec::new(), Vec::new());
    let posed: Vec<ImageId> = scene.registered().map(|(id, ..)| id).collect();
    posed.into_iter().for_each(|image| scene.deregister(image));
    scene
}

/// Gives the cameras their initial focal lengths, and returns the priors on them.
pub(super) fn initial_focal_lengths(
    graph: &CorrespondenceGraph,
    scene: &mut Reconstruction,
    options: &MapperOptions,
) -> Vec<FocalPrior> {
    let mut found = Vec::new();
    if options.refine.focal {
        found = estimate_focal_lengths(graph, scene);
        choose_focal_lengths(graph, scene, options, &found);
    }
    focal_priors(scene, &found)
}

/// Maps the images that are not in `mapped_images`, and returns all models, `models` first.
pub(super) fn map_rest(
    input: Input,
    mut models: Vec<MappedModel>,
    mut mapped_images: BTreeSet<ImageId>,
    terms: &mut [&mut dyn Term],
    descriptors: &mut Descriptors,
    watch: &mut Watch,
    checkpoints: &mut Checkpoints,
) -> Result<Vec<MappedModel>, Error> {
    loop {
        checkpoints.begin(input, &models, &mapped_images, Step::Grow);
        let refiner = Refiner::new(input, input.scene.clone(), reborrow(terms));
        let growth = Growth::new(refiner, mapped_images.clone());
        let mapped = match map_component(growth, descriptors, watch, checkpoints) {
            Ok(mapped) => mapped,
            Err(error) if models.is_empty() || matches!(error, Error::Cancelled) => {
                return Err(error);
            }
            // The remaining images cannot be mapped. The earlier models are kept.
            Err(_) => break,
        };
        let registered = registered(&mapped.reconstruction);
        if models.is_empty() || registered.len() >= input.options.min_model_size {
            models.push(mapped);
        }
        let before = mapped_images.len();
        mapped_images.extend(registered);
        if mapped_images.len() == before {
            break;
        }
    }
    Ok(models)
}

/// Maps one connected component.
fn map_component(
    mut growth: Growth,
    descriptors: &mut Descriptors,
    watch: &mut Watch,
    checkpoints: &mut Checkpoints,
) -> Result<MappedModel, Error> {
    if checkpoints.resumed.is_none() {
        let candidates = growth.candidates();
        match growth.best_initial_pair(&candidates) {
            Some(pair) => growth.initialise(&[pair], watch)?,
            None => growth.initialise(&candidates, watch)?,
        };
    }
    growth.finish(descriptors, watch, checkpoints)
}
