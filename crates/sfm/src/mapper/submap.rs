//! Sub-maps: models of parts of the images, which grow apart and are assembled by the images that
//! they have in common.
//!
//! Parts have no stages after growth: the assembled model has them. It is grown on, too, so that
//! images between parts are registered. A part that does not fit stays a model of its own; where
//! both observe common points after that, [`super::join`] joins them.

use std::collections::BTreeSet;

use tiepoint_adjust::RefineIntrinsics;
use tiepoint_scene::{
    Camera, CameraId, CorrespondenceGraph, Image, ImageId, ImagePair, Reconstruction,
};

use super::growth::Growth;
use super::incremental::{initial_focal_lengths, initialise, without_model};
use super::input::Input;
use super::join::{agrees, registered, with_cameras_of};
use super::refiner::{Refiner, turns};
use super::solution::Solution;
use crate::Error;
use crate::event::Watch;
use crate::model_tools::{align_models, merge_aligned};
use crate::options::{MapperOptions, RigMode};
use crate::saved::{Reader, Saved, Writer};

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
    let (graph, mut blank) = restricted(graph, &whole, images);
    let options = &MapperOptions { rig: RigMode::Off, ..*options };
    if let Some(first) = first {
        calibrate(&mut blank, first, &whole)?;
    }
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
    for solution in &models {
        let mut model = Writer { bytes: Vec::new(), scene: &blank };
        solution.write(&mut model);
        registered(&solution.model).write(&mut to);
        model.bytes.len().write(&mut to);
        to.bytes.extend(model.bytes);
    }
    Ok(to.bytes)
}

/// Gives the cameras of the models of the first part the intrinsics that they have there. The focal
/// lengths of those whose images turn there are known. Each part refines them: what is wrong in one
/// is not wrong in all.
fn calibrate(
    scene: &mut Reconstruction,
    first: &[u8],
    whole: &Reconstruction,
) -> Result<(), Error> {
    let mut models = PartModel::all(first, whole)?;
    // The largest has the last word.
    models.sort_by_key(|part| part.images.len());
    for part in models {
        let model = part.read(whole)?.model;
        for id in model.registered_cameras() {
            let camera = scene.camera_mut(id);
            camera.intrinsics = model.camera(id).intrinsics;
            camera.has_focal_prior |= turns(&model, id);
        }
    }
    Ok(())
}

/// A model in the state of a part. Reading fails with [`Error::OtherSubmaps`] if it is none of the
/// scene.
struct PartModel<'a> {
    /// Its registered images.
    images: BTreeSet<ImageId>,
    bytes: &'a [u8],
}

impl<'a> PartModel<'a> {
    /// The models of a state.
    fn all(state: &'a [u8], scene: &'a Reconstruction) -> Result<Vec<Self>, Error> {
        let mut from = Reader { bytes: state, scene };
        let next = |from: &mut Reader<'a>| {
            let images = BTreeSet::read(from)?;
            let length = usize::read(from)?;
            Some(Self { images, bytes: from.take(length)? })
        };
        let mut models = Vec::new();
        while !from.bytes.is_empty() {
            models.push(next(&mut from).ok_or(Error::OtherSubmaps)?);
        }
        Ok(models)
    }

    /// The model, with cameras that it does not use as in the scene.
    fn read(&self, scene: &Reconstruction) -> Result<Solution, Error> {
        let mut from = Reader { bytes: self.bytes, scene };
        let mut solution = Solution::read(&mut from).ok_or(Error::OtherSubmaps)?;
        let model = &mut solution.model;
        if !from.bytes.is_empty() || registered(model) != self.images {
            return Err(Error::OtherSubmaps);
        }
        let cameras = model.registered_cameras();
        for (id, _) in scene.cameras().filter(|(id, _)| !cameras.contains(id)) {
            model.copy_camera(scene, id);
        }
        Ok(solution)
    }
}

/// The models of all parts, assembled as far as they fit, the largest first. No image is in two.
///
/// # Errors
///
/// [`Error::OtherSubmaps`] if a state is none of this scene.
pub(super) fn assembled(input: Input, states: &[Vec<u8>]) -> Result<Vec<Solution>, Error> {
    let mut left: Vec<PartModel> = Vec::new();
    for state in states {
        left.extend(PartModel::all(state, input.scene)?);
    }
    left.sort_by_key(|part| std::cmp::Reverse(part.images.len()));
    let mut models: Vec<Solution> = Vec::new();
    while !left.is_empty() {
        let mut base = left.remove(0).read(input.scene)?;
        while let Some((index, model)) = next_part(input, &base.model, &left)? {
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
    Ok(models)
}

/// The model with the part that fits and has most images in common with it, and its index.
fn next_part(
    input: Input,
    model: &Reconstruction,
    parts: &[PartModel],
) -> Result<Option<(usize, Reconstruction)>, Error> {
    let there = registered(model);
    let common = |part: &PartModel| part.images.intersection(&there).count();
    let mut order: Vec<(usize, usize)> =
        parts.iter().map(common).enumerate().filter(|(_, count)| *count > 0).collect();
    order.sort_by_key(|(index, count)| (std::cmp::Reverse(*count), *index));
    for (index, _) in order {
        // One at a time is in memory.
        let part = parts[index].read(input.scene)?;
        if let Some(merged) = with_part(input, model, part.model) {
            return Ok(Some((index, merged)));
        }
    }
    Ok(None)
}

/// The model with the images of a part, if most of the matches between the two agree.
fn with_part(input: Input, model: &Reconstruction, part: Reconstruction) -> Option<Reconstruction> {
    let options = MapperOptions { refine: RefineIntrinsics::NONE, ..*input.options };
    let trial = Input::of_trial(input.graph, input.scene, &options);
    let is_same =
        |camera: &CameraId| model.camera(*camera).intrinsics == part.camera(*camera).intrinsics;
    let cameras = part.registered_cameras();
    let shared: Vec<&CameraId> =
        cameras.iter().filter(|id| model.registered_cameras().contains(id)).collect();
    let part = match shared.into_iter().all(is_same) {
        true => part,
        false => with_cameras_of(trial, model, part)?,
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

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use tiepoint_synth::MatchOptions;

    use super::*;
    use crate::mapper::test_scene::scene;

    /// The images of one of two cameras are a part. The other camera is as in the scene, whose
    /// pairs may tell more of it.
    #[test]
    fn cameras_of_other_parts_are_those_of_the_scene() {
        let drawn = scene();
        let (graph, mut blank) = (drawn.graph(&MatchOptions::default()), drawn.without_poses());
        let cameras: Vec<CameraId> = blank.cameras().map(|(id, _)| id).collect();
        let of_first = blank.images().filter(|(_, image)| image.camera == cameras[0]);
        let images: BTreeSet<ImageId> = of_first.map(|(id, _)| id).collect();
        let options = MapperOptions { min_model_size: images.len(), ..MapperOptions::default() };
        let watch = &mut |_: &_| ControlFlow::Continue(());
        let state = map_part(&graph, &blank, &images, None, &options, watch).unwrap();
        for camera in &cameras {
            let focal_px = 1.2 * blank.camera(*camera).intrinsics.mean_focal_px();
            let camera = blank.camera_mut(*camera);
            camera.intrinsics = crate::two_view::with_focal(&camera.intrinsics, focal_px);
        }
        let mut models = PartModel::all(&state, &blank).unwrap();
        let model = models.remove(0).read(&blank).unwrap().model;
        assert!(models.is_empty() && registered(&model) == images);
        let is_of_scene = |camera: CameraId| model.camera(camera) == blank.camera(camera);
        assert!(!is_of_scene(cameras[0]) && is_of_scene(cameras[1]));
        let cut = PartModel::all(&state[..state.len() - 1], &blank);
        assert!(matches!(cut, Err(Error::OtherSubmaps)));
    }
}
