//! One model for each connected component of the image graph.

use std::collections::{BTreeSet, VecDeque};

use tiepoint_adjust::{FocalPrior, Term};
use tiepoint_scene::{CorrespondenceGraph, ImageId, Reconstruction};

use super::checkpoint::{Checkpoints, Step};
use super::focal_trials::choose_focal_lengths;
use super::growth::Growth;
use super::input::Input;
use super::join::registered;
use super::refiner::Refiner;
use super::solution::Solution;
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

/// Maps the images that are not in `mapped_images`, and returns all models, `models` first. Those
/// of `starts`, assembled from sub-maps, grow on before others begin.
pub(super) fn map_rest(
    input: Input,
    starts: &[Solution],
    (mut models, mut mapped_images): (Vec<MappedModel>, BTreeSet<ImageId>),
    terms: &mut [&mut dyn Term],
    descriptors: &mut Descriptors,
    watch: &mut Watch,
    checkpoints: &mut Checkpoints,
) -> Result<Vec<MappedModel>, Error> {
    let mut starts: VecDeque<&Solution> = starts.iter().collect();
    loop {
        // Some are finished: by an earlier run, or within another one.
        starts.retain(|start| registered(&start.model).is_disjoint(&mapped_images));
        checkpoints.begin(input, &models, &mapped_images, Step::Grow);
        let refiner = Refiner::new(input, input.scene.clone(), reborrow(terms));
        let start = starts.pop_front();
        let others = starts.iter().flat_map(|start| registered(&start.model));
        let growth = Growth::new(refiner, others.chain(mapped_images.iter().copied()).collect());
        let mapped = match map_component(growth, start, descriptors, watch, checkpoints) {
            Ok(mapped) => mapped,
            Err(Error::Cancelled) => return Err(Error::Cancelled),
            // Its images begin anew.
            Err(_) if start.is_some() => continue,
            Err(error) if models.is_empty() => return Err(error),
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

/// Maps one connected component, or grows a model on.
fn map_component(
    mut growth: Growth,
    start: Option<&Solution>,
    descriptors: &mut Descriptors,
    watch: &mut Watch,
    checkpoints: &mut Checkpoints,
) -> Result<MappedModel, Error> {
    if checkpoints.resumed.is_none() {
        match start {
            Some(start) => growth.refiner.solution = start.clone(),
            None => initialise(&mut growth, watch)?,
        }
    }
    growth.finish(descriptors, watch, checkpoints)
}

/// Begins a model with its best initial pair.
pub(super) fn initialise(growth: &mut Growth, watch: &mut Watch) -> Result<(), Error> {
    let candidates = growth.candidates();
    match growth.best_initial_pair(&candidates) {
        Some(pair) => growth.initialise(&[pair], watch).map(drop),
        None => growth.initialise(&candidates, watch).map(drop),
    }
}
