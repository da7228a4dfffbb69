//! The incremental mapper: one model for each connected component of the image graph, and merging
//! of models from one rig.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use tiepoint_adjust::FocalPrior;
use tiepoint_scene::{CorrespondenceGraph, ImageId, KnownRigs, Reconstruction};

use super::focal_trials::choose_focal_lengths;
use super::growth::Mapper;
use super::solution::Solution;
use crate::Error;
use crate::event::{Event, OptionalStage, Watch, notify};
use crate::mapped_model::MappedModel;
use crate::options::{MapperOptions, RigMode};
use crate::rigs::{CalibratedRig, Descriptors, merge_by_motion, rig_pairs};
use crate::rolling_shutter::row_poses;
use crate::two_view::{estimate_focal_lengths, focal_priors};

/// Maps all images. Each connected component gives a model; the model with the most images comes
/// first. `scene` gives cameras and images with keypoints; its poses and points are ignored.
/// `descriptors` is used for guided matching with [`RigMode::Soft`], [`RigMode::Rigid`] and
/// [`RigMode::Auto`]. If it returns nothing, no images are matched again.
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
    map_all(graph, scene, None, descriptors, options, watch)
}

/// Maps all images as [`map`] does, with rigs whose extrinsics are known, and registers their
/// frames as a whole. The models have the unit of length of the rigs; [`MapperOptions::rig`] has no
/// effect. If no frame of a model has two images that agree with the extrinsics, its images are
/// registered one by one, and [`MappedModel::failures`] says so.
///
/// # Errors
///
/// As [`map`].
pub fn map_with_rigs(
    graph: &CorrespondenceGraph,
    scene: &Reconstruction,
    rigs: &KnownRigs,
    descriptors: &mut Descriptors,
    options: &MapperOptions,
    watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
) -> Result<Vec<MappedModel>, Error> {
    let options = &MapperOptions { rig: RigMode::Off, ..*options };
    map_all(graph, scene, Some(rigs), descriptors, options, watch)
}

fn map_all(
    graph: &CorrespondenceGraph,
    scene: &Reconstruction,
    rigs: Option<&KnownRigs>,
    descriptors: &mut Descriptors,
    options: &MapperOptions,
    watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
) -> Result<Vec<MappedModel>, Error> {
    options.validate()?;
    let mut options = *options;
    options.tracks.two_view |= graph.num_images() == 2;
    let options = &options;
    let input = Prepared { known_rigs: rigs, ..prepared(graph, scene, options) };
    let mut models = map_rest(graph, &input, Vec::new(), descriptors, options, watch)?;
    models.sort_by_key(|model| std::cmp::Reverse(model.reconstruction.num_registered()));
    if matches!(options.rig, RigMode::Soft | RigMode::Rigid | RigMode::Auto) {
        merge_rig_models(graph, &input.focal_priors, options, &mut models, descriptors, watch)?;
    }
    Ok(models)
}

/// Input of the mapper.
pub(super) struct Prepared<'a> {
    /// The scene without poses and points, with initial focal lengths.
    pub(super) scene: Reconstruction,
    pub(super) focal_priors: Vec<FocalPrior>,
    pub(super) known_rigs: Option<&'a KnownRigs>,
}

/// The scene without poses and points, with initial focal lengths and their priors, without rigs.
pub(super) fn prepared<'a>(
    graph: &CorrespondenceGraph,
    scene: &Reconstruction,
    options: &MapperOptions,
) -> Prepared<'a> {
    let mut scene = scene.clone();
    (scene.rigs, scene.frames) = (Vec::new(), Vec::new());
    let posed: Vec<ImageId> = scene.registered().map(|(id, ..)| id).collect();
    posed.into_iter().for_each(|image| scene.deregister(image));
    let mut found = Vec::new();
    if options.refine.focal {
        found = estimate_focal_lengths(graph, &mut scene);
        choose_focal_lengths(graph, &mut scene, options, &found);
    }
    let focal_priors = focal_priors(&scene, &found);
    Prepared { scene, focal_priors, known_rigs: None }
}

/// Maps the images that are in none of `models`, and returns all models, those first.
pub(super) fn map_rest(
    graph: &CorrespondenceGraph,
    input: &Prepared,
    mut models: Vec<MappedModel>,
    descriptors: &mut Descriptors,
    options: &MapperOptions,
    watch: &mut Watch,
) -> Result<Vec<MappedModel>, Error> {
    let pairs_of_rig = match options.rig {
        RigMode::Paper => rig_pairs(&input.scene),
        _ => Vec::new(),
    };
    let registered = |model: &MappedModel| -> Vec<ImageId> {
        model.reconstruction.registered().map(|(id, ..)| id).collect()
    };
    let mut mapped_images: BTreeSet<ImageId> = models.iter().flat_map(registered).collect();
    loop {
        let mut mapper = Mapper::new(graph, &input.scene, options);
        mapper.focal_priors = &input.focal_priors;
        mapper.rig_pairs = &pairs_of_rig;
        mapper.mapped_images = mapped_images.clone();
        if let Some(rigs) = input.known_rigs {
            mapper.use_rigs(rigs);
        }
        let mapped = match mapper.run(descriptors, watch) {
            Ok(mapped) => mapped,
            Err(error) if models.is_empty() || matches!(error, Error::Cancelled) => {
                return Err(error);
            }
            // The remaining images cannot be mapped. The earlier models are kept.
            Err(_) => break,
        };
        let registered = registered(&mapped);
        if models.is_empty() || registered.len() >= options.min_model_size {
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

/// Merges the largest model with models of other cameras that have no common points with it but
/// move as one rig. A merge is accepted if a rig constraint does not increase the error of held-out
/// tracks.
fn merge_rig_models(
    graph: &CorrespondenceGraph,
    focal_priors: &[FocalPrior],
    options: &MapperOptions,
    models: &mut Vec<MappedModel>,
    descriptors: &mut Descriptors,
    watch: &mut Watch,
) -> Result<(), Error> {
    let mut index = 1;
    while index < models.len() {
        let merged = merge_by_motion(&models[0].reconstruction, &models[index].reconstruction);
        // If the constraint fails, the models stay separate.
        let constrained = merged.and_then(|model| {
            constrained(graph, model, focal_priors, options, descriptors).ok()?
        });
        let Some((reconstruction, rig)) = constrained else {
            index += 1;
            continue;
        };
        let other = models.remove(index);
        let merged = &mut models[0];
        merged.reconstruction = reconstruction;
        merged.rig = Some(rig);
        // The models have no camera in common.
        merged.shutters.extend(other.shutters);
        merged.row_poses = row_poses(&merged.reconstruction, &merged.shutters);
        merged.num_loop_pairs += other.num_loop_pairs;
        merged.failures.extend(other.failures);
        // The rig stage has run on the merged model.
        merged.failures.retain(|failure| failure.stage != OptionalStage::Rig);
        notify(watch, &Event::Merged { num_images: merged.reconstruction.num_registered() })?;
    }
    Ok(())
}

/// Constrains the cameras of a model; `None` if no constraint is accepted.
fn constrained(
    graph: &CorrespondenceGraph,
    model: Reconstruction,
    focal_priors: &[FocalPrior],
    options: &MapperOptions,
    descriptors: &mut Descriptors,
) -> Result<Option<(Reconstruction, CalibratedRig)>, Error> {
    let mut mapper = Mapper::new(graph, &model, options);
    mapper.focal_priors = focal_priors;
    mapper.estimate_noise();
    mapper.constrain_rig(descriptors)?;
    let Solution { model, rig, .. } = mapper.solution;
    Ok(rig.filter(|rig| rig.constraint.is_some()).map(|rig| (model, rig)))
}
