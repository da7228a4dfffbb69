//! Joins models with verified pairs between them: parts of one place that no growth connected.
//!
//! The smaller model takes the intrinsics of the larger one. Then one of the two grows on by images
//! of the other one, at most as many as COLMAP's `max_model_overlap`. The common images give the
//! similarity: the points that they observe in both models, or their poses. Both models are
//! adjusted together, and stay joined if the evidence holds: of the verified matches between the
//! two, most agree with the poses, images of both observe common points, and most images of each
//! stay. Otherwise the models are as they were. A wrong join is worse than none: images that see
//! less of the other model than they should ([`crate::register`]) do not connect.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use tiepoint_adjust::{RefineIntrinsics, Term};
use tiepoint_geometry::Rigid3;
use tiepoint_scene::{
    CorrespondenceGraph, Image, ImageId, ImagePair, PointId, Reconstruction, Track,
};

use super::checkpoint::{Checkpoints, Step};
use super::existing::similarity_of_poses;
use super::growth::Growth;
use super::input::Input;
use super::refinement_schedule::RefinementSchedule;
use super::refiner::Refiner;
use crate::Error;
use crate::event::{Event, Watch, notify};
use crate::mapped_model::{MappedModel, OtherPlace};
use crate::model_tools::{ModelAlignment, align_models, merge_aligned};
use crate::options::MapperOptions;
use crate::register::find_each_other;
use crate::rigs::Descriptors;
use crate::terms::reborrow;
use crate::two_view::{Agreement, VerifyOptions, agreement};

/// Maximum number of images that a model takes from the other one: COLMAP's default.
const MAX_OVERLAP: usize = 20;
/// Minimum number of points that images of both models observe: as many as the inliers of a
/// verified pair.
const MIN_COMMON_POINTS: usize = 15;

/// Joins models as far as the evidence goes. `models` come and stay in descending order of size.
/// Those before the index `larger` are joined with none; `resumed`: the index of the one that an
/// earlier run joined with it.
pub(super) fn join_models(
    input: Input,
    models: &mut Vec<MappedModel>,
    (mut larger, mut resumed): (usize, Option<usize>),
    terms: &mut [&mut dyn Term],
    descriptors: &mut Descriptors,
    watch: &mut Watch,
    checkpoints: &mut Checkpoints,
) -> Result<(), Error> {
    let begin = |checkpoints: &mut Checkpoints, models: &[MappedModel], larger, smaller| {
        let images = models.iter().flat_map(|model| registered(&model.reconstruction)).collect();
        checkpoints.begin(input, models, &images, Step::Join { larger, smaller });
    };
    while larger + 1 < models.len() {
        begin(checkpoints, models, larger, resumed);
        let found = match resumed.take() {
            // The joined model is that of the checkpoint.
            Some(smaller) => Some((smaller, input.scene.clone())),
            None => (larger + 1..models.len()).find_map(|smaller| {
                let [one, other] = [larger, smaller].map(|k| &models[k]);
                let joined = match one.is_other_place_than(other) {
                    true => joined_places(input, one, other)?,
                    false => joined(input, &one.reconstruction, &other.reconstruction)?,
                };
                Some((smaller, joined))
            }),
        };
        let Some((smaller, model)) = found else {
            larger += 1;
            continue;
        };
        let others = models.iter().enumerate().filter(|(k, _)| ![larger, smaller].contains(k));
        let taken = others.flat_map(|(_, model)| registered(&model.reconstruction)).collect();
        let mut refiner = Refiner::new(input, model, reborrow(terms));
        refiner.solution.initial_pair = models[larger].initial_pair;
        let images = registered(&refiner.solution.model);
        let other_places = [larger, smaller].map(|k| models[k].other_places.clone());
        let mut other_places: Vec<OtherPlace> = other_places.into_iter().flatten().collect();
        // One that is in the model now is none any more.
        other_places
            .retain(|place| 2 * place.images.intersection(&images).count() <= place.images.len());
        refiner.solution.other_places = other_places;
        begin(checkpoints, models, larger, Some(smaller));
        // Registers images that neither model could register.
        match Growth::new(refiner, taken).finish(descriptors, watch, checkpoints) {
            Ok(model) => models[larger] = model,
            Err(Error::Cancelled) => return Err(Error::Cancelled),
            // The models stay separate.
            Err(_) => {
                larger += 1;
                continue;
            }
        }
        models.remove(smaller);
        let num_images = models[larger].reconstruction.num_registered();
        notify(watch, &Event::Merged { num_images })?;
        sort_by_size(models);
        larger = 0;
    }
    Ok(())
}

/// The largest model first: by images, then by points.
pub(super) fn sort_by_size(models: &mut [MappedModel]) {
    models.sort_by_key(|model| {
        let model = &model.reconstruction;
        std::cmp::Reverse((model.num_registered(), model.num_tracks()))
    });
}

pub(super) fn registered(model: &Reconstruction) -> BTreeSet<ImageId> {
    model.registered().map(|(id, ..)| id).collect()
}

/// The verified pairs between the images of two models.
fn pairs_between(
    graph: &CorrespondenceGraph,
    one: &Reconstruction,
    other: &Reconstruction,
) -> Vec<ImagePair> {
    let (one, other) = (registered(one), registered(other));
    let is_between = |pair: &&ImagePair| {
        let between = |a, b| one.contains(a) && other.contains(b);
        between(&pair.a, &pair.b) || between(&pair.b, &pair.a)
    };
    graph.pairs().keys().filter(is_between).copied().collect()
}

/// Two places that look alike in one model: only the pairs count that contradicted the one place.
/// Some of these are wrong, and match other sides of what looks alike. Where the places meet,
/// images of one find what those of the other see.
fn joined_places(input: Input, one: &MappedModel, other: &MappedModel) -> Option<Reconstruction> {
    let places = || [one, other].into_iter().flat_map(|model| &model.other_places);
    let is_connection = |pair: &ImagePair| places().any(|place| place.connections.contains(pair));
    let (one, other) = (&one.reconstruction, &other.reconstruction);
    let between = pairs_between(input.graph, one, other);
    let (connections, wrong): (Vec<ImagePair>, Vec<ImagePair>) =
        between.into_iter().partition(is_connection);
    if connections.is_empty() {
        return None;
    }
    let graph = input.graph.filtered(|pair| wrong.binary_search(pair).is_err());
    let model = joined(Input { graph: &graph, ..input }, one, other)?;
    // Of the other pairs those match the same points that agree with this model.
    let model = refined(input, model)?;
    find_each_other(input.graph, &model, &registered(one)).then_some(model)
}

/// Both models in one, adjusted together; `None` without evidence.
fn joined(input: Input, one: &Reconstruction, other: &Reconstruction) -> Option<Reconstruction> {
    let (of_one, of_other) = (registered(one), registered(other));
    let between = pairs_between(input.graph, one, other);
    if between.is_empty() {
        return None;
    }
    let options = MapperOptions { refine: RefineIntrinsics::NONE, ..*input.options };
    let trial = Input::of_trial(input.graph, input.scene, &options);
    let one = detected(input, one.clone());
    let other = with_cameras_of(trial, &one, detected(input, other.clone()))?;
    let merged = merged(trial, &one, &other).or_else(|| merged(trial, &other, &one))?;
    if !agrees(input, &merged, &between, options.register.max_error_px) {
        return None;
    }
    let trial = Input { focal_priors: input.focal_priors, options: input.options, ..trial };
    let model = refined(trial, merged)?;
    let of_joined = registered(&model);
    let most_stay =
        |images: &BTreeSet<ImageId>| 2 * images.intersection(&of_joined).count() > images.len();
    let is_common = |(_, track): &(PointId, &Track)| {
        [&of_one, &of_other].iter().all(|images| {
            track.observations.iter().any(|observation| images.contains(&observation.image))
        })
    };
    let holds = most_stay(&of_one)
        && most_stay(&of_other)
        && model.tracks().filter(is_common).count() >= MIN_COMMON_POINTS
        && agrees(input, &model, &between, VerifyOptions::default().max_error_px);
    holds.then_some(model)
}

fn refined(trial: Input, model: Reconstruction) -> Option<Reconstruction> {
    let mut refiner = Refiner::new(trial, model, Vec::new());
    refiner.refine_globally(&RefinementSchedule::AFTER_LOOP_CLOSURE, &mut unwatched).ok()?;
    Some(refiner.solution.model)
}

/// The smaller model with the cameras that it has in common with the larger one as these are there.
pub(super) fn with_cameras_of(
    trial: Input,
    one: &Reconstruction,
    mut model: Reconstruction,
) -> Option<Reconstruction> {
    for camera in model.registered_cameras().intersection(&one.registered_cameras()) {
        model.copy_camera(one, *camera);
    }
    refined(trial, model)
}

/// A model with another one, which takes images of the first one for it; `None` if these do not
/// give a similarity.
fn merged(trial: Input, model: &Reconstruction, other: &Reconstruction) -> Option<Reconstruction> {
    let free = registered(model);
    let not_free = trial.scene.images().map(|(id, _)| id).filter(|id| !free.contains(id)).collect();
    let max_images = other.num_registered() + MAX_OVERLAP;
    let refiner = Refiner::new(trial, other.clone(), Vec::new());
    let mut growth = Growth::overlap(refiner, not_free, max_images);
    growth.grow(&mut unwatched).ok()?;
    let extended = growth.refiner.solution.model;
    let mut merged = model.clone();
    for camera in extended.registered_cameras().difference(&model.registered_cameras()) {
        merged.copy_camera(&extended, *camera);
    }
    let max_error_px = trial.options.filter.max_error_px;
    let alignment = aligned(&extended, model, max_error_px)?;
    merge_aligned(&mut merged, &extended, alignment, max_error_px);
    Some(merged)
}

/// The similarity between models with common images: by the points that these observe in both, or,
/// if they observe hardly any, by their poses. `None` if the points contradict.
fn aligned(
    extended: &Reconstruction,
    model: &Reconstruction,
    max_error_px: f64,
) -> Option<ModelAlignment> {
    let mut alignment = align_models(extended, model, max_error_px).ok()?;
    if alignment.num_common_observations < MIN_COMMON_POINTS {
        let pose = |id: ImageId| model.image(id).cam_from_world();
        let both = |(id, _, before): (ImageId, &Image, &Rigid3)| Some((*before, *pose(id)?));
        let common: Vec<(Rigid3, Rigid3)> = extended.registered().filter_map(both).collect();
        alignment.reference_from_model = similarity_of_poses(&common);
    }
    alignment.reference_from_model.map(|_| alignment)
}

/// The model with keypoints as detected, without rigs: later stages correct and constrain again.
fn detected(input: Input, mut model: Reconstruction) -> Reconstruction {
    (model.rigs, model.frames) = (Vec::new(), Vec::new());
    if input.options.readout.is_some() {
        for (id, image) in input.scene.images() {
            let pixels: Vec<_> = image.keypoints.iter().map(|keypoint| keypoint.pixel).collect();
            model.move_keypoints(id, &pixels);
        }
    }
    model
}

/// Whether most of the verified matches of these pairs agree with the poses.
pub(super) fn agrees(
    input: Input,
    model: &Reconstruction,
    pairs: &[ImagePair],
    max_error_px: f64,
) -> bool {
    let mut sum = Agreement::default();
    for &pair in pairs {
        let pose = |image| model.image(image).cam_from_world();
        let (Some(a), Some(b)) = (pose(pair.a), pose(pair.b)) else { continue };
        sum.add(agreement(input.graph, model, pair, [a, b], max_error_px));
    }
    sum.is_majority()
}

fn unwatched(_: &Event) -> ControlFlow<()> {
    ControlFlow::Continue(())
}
