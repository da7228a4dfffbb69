//! Sub-maps: models of parts of the images, which grow apart and are assembled by the images that
//! they have in common.
//!
//! Parts have no stages after growth: the assembled model has them. It is grown on, too, so that
//! images between parts are registered. A part that does not fit stays a model of its own; where
//! both observe common points after that, [`super::join`] joins them.

use std::collections::BTreeSet;

use rayon::prelude::*;
use tiepoint_adjust::RefineIntrinsics;
use tiepoint_scene::{
    Camera, CameraId, CorrespondenceGraph, Image, ImageId, ImagePair, Reconstruction,
};

use super::growth::Growth;
use super::incremental::{initial_focal_lengths, initialise, without_model};
use super::input::Input;
use super::join::{agrees, registered, with_cameras_of};
use super::refiner::{Refiner, has_rotation};
use super::solution::Solution;
use crate::Error;
use crate::event::Watch;
use crate::model_tools::{align_models, merge_aligned};
use crate::options::{MapperOptions, RigMode};
use crate::saved::{Reader, Saved, Writer, write_list};

/// The scene and the graph of some images alone. Ids stay; other images have no keypoints. Cameras
/// of other images alone have a focal length: no pair of the part tells any.
fn restricted(
    graph: &CorrespondenceGraph,
    scene: &Reconstruction,
    images: &BTreeSet<ImageId>,
) -> (CorrespondenceGraph, Reconstruction) {
    let mut part = Reconstruction::default();
    part.calibrated.clone_from(&scene.calibrated);
    part.intrinsics_priors.clone_from(&scene.intrinsics_priors);
    part.portrait_landscape_pairs.clone_from(&scene.portrait_landscape_pairs);
    let cameras: BTreeSet<CameraId> = images.iter().map(|id| scene.image(*id).camera).collect();
    for (id, camera) in scene.cameras() {
        let has_focal_prior = camera.has_focal_prior || !cameras.contains(&id);
        part.add_camera(Camera { has_focal_prior, ..*camera });
    }
    for (id, image) in scene.images() {
        let keypoints = if images.contains(&id) { image.keypoints.to_vec() } else { Vec::new() };
        let copy = part.add_image(Image::new(&*image.name, image.camera, keypoints));
        part.set_stream(copy, image.stream.clone());
        part.set_time(copy, image.time_s);
    }
    let counts: Vec<usize> = part.images().map(|(_, image)| image.keypoints.len()).collect();
    let is_inside = |pair: &ImagePair| images.contains(&pair.a) && images.contains(&pair.b);
    let pairs = graph.pairs().iter().filter(|(pair, _)| is_inside(pair));
    (CorrespondenceGraph::new(&counts, pairs.map(|(pair, view)| (*pair, view.clone()))), part)
}

/// The state of the models of a part. `first`: that of the part whose intrinsics the others begin
/// with.
///
/// # Errors
///
/// [`Error::OtherSubmaps`] if `first` is none of this scene; [`Error::Cancelled`].
pub(super) fn map_part(
    graph: &CorrespondenceGraph,
    scene: &Reconstruction,
    images: &BTreeSet<ImageId>,
    first: Option<&[u8]>,
    options: &MapperOptions,
    watch: &mut Watch,
) -> Result<Vec<u8>, Error> {
    // States are of all images: those of another part have keypoints there.
    let whole = without_model(scene);
    let first =
        first.map(|state| models_of(state, &whole).ok_or(Error::OtherSubmaps)).transpose()?;
    let (graph, mut blank) = restricted(graph, &whole, images);
    let options = &MapperOptions { rig: RigMode::Off, ..*options };
    calibrate(&mut blank, &first.unwrap_or_default());
    let focal_priors = initial_focal_lengths(&graph, &mut blank, options);
    let input = Input { focal_priors: &focal_priors, ..Input::of_trial(&graph, &blank, options) };
    let others = blank.images().map(|(id, _)| id).filter(|id| !images.contains(id));
    let mut taken: BTreeSet<ImageId> = others.collect();
    let mut models: Vec<Solution> = Vec::new();
    loop {
        let refiner = Refiner::new(input, blank.clone(), Vec::new());
        let mut growth = Growth::new(refiner, taken.clone());
        match initialise(&mut growth, watch).and_then(|()| growth.grow(watch)) {
            Ok(()) => {}
            Err(Error::Cancelled) => return Err(Error::Cancelled),
            Err(_) => break,
        }
        let solution = growth.refiner.solution;
        let found = registered(&solution.model);
        let before = taken.len();
        taken.extend(&found);
        if found.len() >= options.min_model_size {
            models.push(solution);
        }
        if taken.len() == before {
            break;
        }
    }
    let mut to = Writer { bytes: Vec::new(), scene: &blank };
    write_list(&models, &mut to);
    Ok(to.bytes)
}

/// Gives the cameras that the models of the first part have the intrinsics that they have there. If
/// that model determines focal lengths, they are known. Each part refines them: what is wrong in
/// one is not wrong in all.
fn calibrate(scene: &mut Reconstruction, first: &[Solution]) {
    let mut models: Vec<&Reconstruction> = first.iter().map(|part| &part.model).collect();
    // The largest has the last word.
    models.sort_by_key(|model| model.num_registered());
    for model in models {
        for id in model.registered_cameras() {
            let camera = scene.camera_mut(id);
            camera.intrinsics = model.camera(id).intrinsics;
            camera.has_focal_prior |= has_rotation(model);
        }
    }
}

/// The models of a state; `None` if it is none of this scene.
fn models_of(state: &[u8], scene: &Reconstruction) -> Option<Vec<Solution>> {
    let mut from = Reader { bytes: state, scene };
    let found = Vec::read(&mut from)?;
    from.bytes.is_empty().then_some(found)
}

/// The models of all parts, assembled as far as they fit, the largest first. No image is in two.
/// `None` if a state is none of this scene.
pub(super) fn assembled(input: Input, states: &[Vec<u8>]) -> Option<Vec<Solution>> {
    let parts: Option<Vec<Vec<Solution>>> =
        states.par_iter().map(|state| models_of(state, input.scene)).collect();
    let mut left: Vec<Solution> = parts?.into_iter().flatten().collect();
    left.sort_by_key(|part| std::cmp::Reverse(part.model.num_registered()));
    let mut models: Vec<Solution> = Vec::new();
    while !left.is_empty() {
        let mut base = left.remove(0);
        while let Some((index, model)) = next_part(input, &base.model, &left) {
            left.remove(index);
            base.model = model;
        }
        models.push(base);
    }
    let mut taken = BTreeSet::new();
    for Solution { model, .. } in &mut models {
        let images = registered(model);
        images.intersection(&taken).for_each(|image| model.deregister(*image));
        taken.extend(images);
    }
    models.retain(|part| part.model.num_registered() >= input.options.min_model_size);
    models.sort_by_key(|part| std::cmp::Reverse(part.model.num_registered()));
    Some(models)
}

/// The model with the part that fits and has most images in common with it, and its index.
fn next_part(
    input: Input,
    model: &Reconstruction,
    parts: &[Solution],
) -> Option<(usize, Reconstruction)> {
    let there = registered(model);
    let common = |part: &Solution| registered(&part.model).intersection(&there).count();
    let mut order: Vec<(usize, usize)> =
        parts.iter().map(common).enumerate().filter(|(_, count)| *count > 0).collect();
    order.sort_by_key(|(index, count)| (std::cmp::Reverse(*count), *index));
    order.into_iter().find_map(|(index, _)| Some((index, with_part(input, model, &parts[index])?)))
}

/// The model with the images of a part, if most of the matches between the two agree.
fn with_part(input: Input, model: &Reconstruction, part: &Solution) -> Option<Reconstruction> {
    let options = MapperOptions { refine: RefineIntrinsics::NONE, ..*input.options };
    let trial = Input::of_trial(input.graph, input.scene, &options);
    let is_same = |camera: &CameraId| {
        model.camera(*camera).intrinsics == part.model.camera(*camera).intrinsics
    };
    let cameras = part.model.registered_cameras();
    let shared: Vec<&CameraId> =
        cameras.iter().filter(|id| model.registered_cameras().contains(id)).collect();
    let part = match shared.into_iter().all(is_same) {
        true => part.model.clone(),
        false => with_cameras_of(trial, model, part.model.clone())?,
    };
    let max_error_px = options.filter.max_error_px;
    let alignment = align_models(&part, model, max_error_px).ok()?;
    let (of_model, of_part) = (registered(model), registered(&part));
    let mut merged = model.clone();
    for camera in part.registered_cameras().difference(&model.registered_cameras()) {
        merged.copy_camera(&part, *camera);
    }
    alignment.reference_from_model?;
    merge_aligned(&mut merged, &part, alignment, max_error_px);
    let (only_model, only_part) = (&of_model - &of_part, &of_part - &of_model);
    let is_between = |pair: &&ImagePair| {
        let between = |a, b| only_model.contains(a) && only_part.contains(b);
        between(&pair.a, &pair.b) || between(&pair.b, &pair.a)
    };
    let between: Vec<ImagePair> = input.graph.pairs().keys().filter(is_between).copied().collect();
    let holds =
        between.is_empty() || agrees(input, &merged, &between, options.register.max_error_px);
    holds.then_some(merged)
}
