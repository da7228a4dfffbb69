//! The incremental mapper: one model for each connected component of the image graph, and merging
//! of models from one rig.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use tiepoint_scene::{CorrespondenceGraph, ImageId, Reconstruction};

use super::focal_trials::choose_focal_lengths;
use super::growth::Mapper;
use super::solution::Solution;
use crate::Error;
use crate::event::{Event, OptionalStage, Watch, tell};
use crate::mapped_model::MappedModel;
use crate::options::{MapperOptions, RigTerm};
use crate::rigs::{CalibratedRig, Descriptors, merge_by_motion, rig_pairs};
use crate::rolling_shutter::row_poses;
use crate::two_view::{FocalPrior, estimate_focal_lengths, focal_priors};

/// Maps all images. Each connected component gives a model; the model with the most images comes
/// first. `scene` gives cameras and images with keypoints; its poses and points are ignored.
/// `descriptors` is used for guided matching with [`RigTerm::Soft`], [`RigTerm::Hard`] and
/// [`RigTerm::Auto`]. If it returns nothing, no images are matched again.
///
/// # Errors
///
/// If the first model fails, or if `watch` asks to stop.
pub fn map(
    graph: &CorrespondenceGraph,
    scene: &Reconstruction,
    descriptors: &mut Descriptors,
    options: &MapperOptions,
    watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
) -> Result<Vec<MappedModel>, Error> {
    let mut scene = scene.clone();
    (scene.rigs, scene.frames) = (Vec::new(), Vec::new());
    let posed: Vec<ImageId> = scene.registered().map(|(id, ..)| id).collect();
    posed.into_iter().for_each(|image| scene.deregister(image));
    let mut options = *options;
    options.tracks.two_view |= graph.num_images() == 2;
    let options = &options;
    let mut found = Vec::new();
    if options.refine.focal {
        found = estimate_focal_lengths(graph, &mut scene);
        choose_focal_lengths(graph, &mut scene, options, &found);
    }
    let focal_priors = focal_priors(&scene, &found);
    let rigs = match options.rig {
        RigTerm::Paper => rig_pairs(&scene),
        _ => Vec::new(),
    };
    let mut models: Vec<MappedModel> = Vec::new();
    let mut taken: BTreeSet<ImageId> = BTreeSet::new();
    loop {
        let mut mapper = Mapper::new(graph, &scene, options);
        mapper.focal_priors = &focal_priors;
        mapper.rigs = &rigs;
        mapper.taken = taken.clone();
        let mapped = match mapper.run(descriptors, watch) {
            Ok(mapped) => mapped,
            Err(error) if models.is_empty() || matches!(error, Error::Cancelled) => {
                return Err(error);
            }
            // The remaining images cannot be mapped. The earlier models are kept.
            Err(_) => break,
        };
        let registered: Vec<ImageId> =
            mapped.reconstruction.registered().map(|(id, ..)| id).collect();
        if models.is_empty() || registered.len() >= options.min_model_size {
            models.push(mapped);
        }
        let before = taken.len();
        taken.extend(registered);
        if taken.len() == before {
            break;
        }
    }
    models.sort_by_key(|model| std::cmp::Reverse(model.reconstruction.num_registered()));
    if matches!(options.rig, RigTerm::Soft | RigTerm::Hard | RigTerm::Auto) {
        join(graph, &focal_priors, options, &mut models, descriptors, watch)?;
    }
    Ok(models)
}

/// Merges the largest model with models of other cameras that have no common points with it but
/// move as one rig. A merge is accepted if a rig constraint does not increase the error of held-out
/// tracks.
fn join(
    graph: &CorrespondenceGraph,
    focal_priors: &[FocalPrior],
    options: &MapperOptions,
    models: &mut Vec<MappedModel>,
    descriptors: &mut Descriptors,
    watch: &mut Watch,
) -> Result<(), Error> {
    let mut index = 1;
    while index < models.len() {
        let whole = merge_by_motion(&models[0].reconstruction, &models[index].reconstruction);
        // If the constraint fails, the models stay separate.
        let held =
            whole.and_then(|model| held(graph, model, focal_priors, options, descriptors).ok()?);
        let Some((reconstruction, rig)) = held else {
            index += 1;
            continue;
        };
        let further = models.remove(index);
        let whole = &mut models[0];
        whole.reconstruction = reconstruction;
        whole.rig = Some(rig);
        // The models have no camera in common.
        whole.shutters.extend(further.shutters);
        whole.row_poses = row_poses(&whole.reconstruction, &whole.shutters);
        whole.num_loop_pairs += further.num_loop_pairs;
        whole.failures.extend(further.failures);
        // The rig stage has run on the merged model.
        whole.failures.retain(|failure| failure.stage != OptionalStage::Rig);
        tell(watch, &Event::Joined { num_images: whole.reconstruction.num_registered() })?;
    }
    Ok(())
}

/// Constrains the cameras of a model; `None` if no constraint is accepted.
fn held(
    graph: &CorrespondenceGraph,
    model: Reconstruction,
    focal_priors: &[FocalPrior],
    options: &MapperOptions,
    descriptors: &mut Descriptors,
) -> Result<Option<(Reconstruction, CalibratedRig)>, Error> {
    let mut mapper = Mapper::new(graph, &model, options);
    mapper.focal_priors = focal_priors;
    mapper.weigh();
    mapper.constraint(descriptors)?;
    let Solution { model, rig, .. } = mapper.solution;
    Ok(rig.filter(|rig| rig.constraint.is_some()).map(|rig| (model, rig)))
}
