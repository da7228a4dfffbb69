//! The incremental mapper: models of everything that hangs together, and of cameras that ride together.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use tiepoint_geometry::Loss;
use tiepoint_scene::{CorrespondenceGraph, ImageId, Reconstruction};

use crate::adjust::RefineIntrinsics;
use crate::event::tell;
use crate::filter::FilterOptions;
use crate::focal::{FocalPrior, estimate_focal_lengths, focal_priors};
use crate::focal_trials::choose_focal_lengths;
use crate::join::joined;
use crate::mapper::Mapper;
use crate::mounting::Descriptors;
use crate::register::RegisterOptions;
use crate::rig_pairs::rig_pairs;
use crate::shutter::Readout;
use crate::tracks::TrackOptions;
use crate::{Error, Event};

/// What holds cameras that ride together to each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RigTerm {
    /// Nothing.
    #[default]
    Off,
    /// The baseline constraint of Huang, Elhashash & Qin 2022, Eq. (2)-(4), to the letter. What the paper leaves open: one unit is the
    /// distance of the initial pair, which is held, with the pose of its first image, and never normalised again.
    Paper,
    /// One mounting for each camera, held up to standard deviations that are found by held-out tracks.
    Soft,
    /// One mounting for each camera, held exactly.
    Hard,
    /// Of off, soft and hard the firmest that held-out tracks do not contradict.
    Auto,
}

/// How to map.
#[derive(Clone, Copy, Debug)]
pub struct MapperOptions {
    /// What may be refined of the cameras.
    pub refine: RefineIntrinsics,
    /// Tracks.
    pub tracks: TrackOptions,
    /// Filters.
    pub filter: FilterOptions,
    /// Registration.
    pub register: RegisterOptions,
    /// Fewer triangulated matches cannot start a model.
    pub min_initial_inliers: usize,
    /// Models with fewer images are dropped, unless it is the only one.
    pub min_model_size: usize,
    /// Of each weighted residual while the model grows.
    pub loss: Loss,
    /// Images in a local adjustment.
    pub local_images: usize,
    /// A global adjustment follows when images or points have grown by this factor.
    pub global_growth: f64,
    /// Between cameras that ride together.
    pub rig: RigTerm,
    /// Of cameras with a rolling shutter; by default all rows count as exposed at once.
    pub readout: Option<Readout>,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for MapperOptions {
    fn default() -> Self {
        Self {
            refine: RefineIntrinsics::ALL,
            tracks: TrackOptions::default(),
            filter: FilterOptions::default(),
            register: RegisterOptions::default(),
            min_initial_inliers: 30,
            min_model_size: 3,
            loss: Loss::SoftL1(4.0),
            local_images: 6,
            global_growth: 1.1,
            rig: RigTerm::Off,
            readout: None,
            seed: 0,
        }
    }
}

/// Maps all images that hang together, one model for each connected part, the one with the most images first. `scene` gives the
/// cameras and the images with their keypoints; poses and points in it are ignored. `descriptors` is asked where images are to be matched
/// again, which only [`RigTerm::Soft`], [`RigTerm::Hard`] and [`RigTerm::Auto`] do: without any they are not.
pub fn map(
    graph: &CorrespondenceGraph,
    scene: &Reconstruction,
    descriptors: &mut Descriptors,
    options: &MapperOptions,
    watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
) -> Result<Vec<Reconstruction>, Error> {
    let mut scene = scene.clone();
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
    let mut models: Vec<Reconstruction> = Vec::new();
    let mut taken: BTreeSet<ImageId> = BTreeSet::new();
    loop {
        let mut mapper = Mapper::new(graph, &scene, options);
        mapper.focal_priors = &focal_priors;
        mapper.rigs = &rigs;
        mapper.taken = taken.clone();
        match mapper.run(descriptors, watch) {
            Ok(()) => {}
            // What the earlier models left does not begin, or falls apart again: that is no reason to lose those.
            Err(Error::NoInitialPair { .. } | Error::NothingToAdjust { .. }) if !models.is_empty() => break,
            Err(error) => return Err(error),
        }
        let registered: Vec<ImageId> = mapper.model.registered().map(|(id, ..)| id).collect();
        let model = mapper.model;
        if models.is_empty() || registered.len() >= options.min_model_size {
            models.push(model);
        }
        let before = taken.len();
        taken.extend(registered);
        if taken.len() == before {
            break;
        }
    }
    models.sort_by_key(|model| std::cmp::Reverse(model.num_registered()));
    if matches!(options.rig, RigTerm::Soft | RigTerm::Hard | RigTerm::Auto) {
        join(graph, &focal_priors, options, &mut models, descriptors, watch)?;
    }
    Ok(models)
}

/// Joins the largest model with those of cameras that see nothing of it and ride with it, if holding them to a mounting explains tracks
/// that took no part as well as holding nothing.
fn join(
    graph: &CorrespondenceGraph,
    focal_priors: &[FocalPrior],
    options: &MapperOptions,
    models: &mut Vec<Reconstruction>,
    descriptors: &mut Descriptors,
    watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
) -> Result<(), Error> {
    let mut index = 1;
    while index < models.len() {
        let whole = joined(&models[0], &models[index]);
        // What cannot be held stays apart.
        let held = whole.and_then(|model| held(graph, model, focal_priors, options, descriptors).ok()?);
        let Some((model, told)) = held else {
            index += 1;
            continue;
        };
        models.remove(index);
        models[0] = model;
        tell(watch, &Event::Joined { num_images: models[0].num_registered() })?;
        told.iter().try_for_each(|event| tell(watch, event))?;
    }
    Ok(())
}

/// A model with its cameras held to their mountings, and what was told of it; `None` where they are better not held.
fn held(
    graph: &CorrespondenceGraph,
    model: Reconstruction,
    focal_priors: &[FocalPrior],
    options: &MapperOptions,
    descriptors: &mut Descriptors,
) -> Result<Option<(Reconstruction, Vec<Event>)>, Error> {
    let mut mapper = Mapper::new(graph, &model, options);
    mapper.focal_priors = focal_priors;
    mapper.weigh();
    let mut told = Vec::new();
    mapper.hold(descriptors, &mut |event| {
        told.push(event.clone());
        ControlFlow::Continue(())
    })?;
    let is_held = told.iter().any(|event| matches!(event, Event::Mounted { hold: Some(_), .. }));
    Ok(is_held.then_some((mapper.model, told)))
}
