//! One model for each connected component of the image graph.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use tiepoint_adjust::{FocalPrior, Term};
use tiepoint_scene::{CameraId, CorrespondenceGraph, ImageId, Reconstruction};

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

/// A model with so many images of a camera gives later models its intrinsics: as many as the first
/// selection of a camera model has. Not varied.
const MIN_IMAGES: usize = 10;

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
        let others = models.iter().map(|model| &model.reconstruction);
        let scene = &with_lenses_of(input.scene, others);
        // A prior about the guess would pull the focal lengths back to it.
        let focal_priors: Vec<FocalPrior> = input
            .focal_priors
            .iter()
            .map(|prior| about_lens_of(scene, input.scene, prior))
            .collect();
        let input = Input { scene, focal_priors: &focal_priors, ..input };
        let refiner = Refiner::new(input, scene.clone(), reborrow(terms));
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

/// The scene in which cameras have the intrinsics of the model with the most of their images: they
/// are the same lenses. A camera with a calibration begins with that, and one with fewer than
/// [`MIN_IMAGES`] as it would alone.
fn with_lenses_of<'a>(
    scene: &Reconstruction,
    models: impl Iterator<Item = &'a Reconstruction>,
) -> Reconstruction {
    let mut scene = scene.clone();
    let mut most = BTreeMap::new();
    for model in models {
        let mut counts: BTreeMap<CameraId, usize> = BTreeMap::new();
        model.registered().for_each(|(_, image, _)| *counts.entry(image.camera).or_default() += 1);
        for (camera, count) in counts {
            let most = most.entry(camera).or_insert(MIN_IMAGES - 1);
            let is_known =
                scene.calibrated.contains(&camera) || scene.intrinsics_priors.contains_key(&camera);
            if count > *most && !is_known {
                *most = count;
                scene.camera_mut(camera).intrinsics = model.camera(camera).intrinsics;
            }
        }
    }
    scene
}

/// The prior on the focal length of a camera about that of `scene`, as wide as it was in relation
/// to the focal length, unless that is as it was `before`.
fn about_lens_of(
    scene: &Reconstruction,
    before: &Reconstruction,
    prior: &FocalPrior,
) -> FocalPrior {
    let [now, before] = [scene, before].map(|scene| scene.camera(prior.camera).intrinsics);
    if now == before {
        return *prior;
    }
    let mean_px = now.mean_focal_px();
    FocalPrior { mean_px, sigma_px: prior.sigma_px / prior.mean_px * mean_px, ..*prior }
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

#[cfg(test)]
mod tests {
    use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};
    use tiepoint_scene::{Camera, Image};

    use super::*;

    const FOUND: [f64; 2] = [300.0, 310.0];
    const BEFORE: f64 = 768.0;

    fn radial(focal_px: f64) -> Intrinsics {
        Intrinsics::new(CameraModelKind::SimpleRadial, &[focal_px, 320.0, 240.0, 0.0]).unwrap()
    }

    /// Two cameras with `counts` images with a pose, and a focal length.
    fn model(counts: [usize; 2], focal_px: f64) -> Reconstruction {
        let mut model = Reconstruction::default();
        for count in counts {
            let intrinsics = radial(focal_px);
            let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: false };
            let camera = model.add_camera(camera);
            for k in 0..count {
                let image = Image::new(format!("{}/{k}.png", camera.index()), camera, Vec::new());
                let image = model.add_image(image);
                model.register(image, Rigid3::identity());
            }
        }
        model
    }

    #[test]
    fn later_models_begin_with_the_lens_of_the_one_with_the_most_images() {
        let scene = model([0, 0], BEFORE);
        let models =
            [model([MIN_IMAGES, 0], FOUND[0]), model([MIN_IMAGES + 1, MIN_IMAGES], FOUND[1])];
        let focals = |scene: &Reconstruction, models: &[Reconstruction]| {
            let found = with_lenses_of(scene, models.iter());
            [0, 1].map(|k| found.camera(CameraId::from_index(k)).intrinsics.mean_focal_px())
        };
        assert_eq!(focals(&scene, &models), [FOUND[1]; 2]);
        assert_eq!(focals(&scene, &models[..1]), [FOUND[0], BEFORE]);
        assert_eq!(focals(&scene, &[model([MIN_IMAGES - 1, 0], FOUND[0])]), [BEFORE; 2]);
        let mut known = scene;
        known.calibrated.insert(CameraId::from_index(1));
        assert_eq!(focals(&known, &models), [FOUND[1], BEFORE]);
    }

    #[test]
    fn a_prior_follows_the_lens_that_changed() {
        let (before, now) = (model([0, 0], BEFORE), model([0, 0], FOUND[0]));
        let prior = |mean_px: f64| FocalPrior {
            camera: CameraId::from_index(1),
            mean_px,
            sigma_px: 0.1 * mean_px,
        };
        assert_eq!(about_lens_of(&before, &before, &prior(700.0)), prior(700.0));
        let moved = about_lens_of(&now, &before, &prior(700.0));
        assert_eq!(moved.mean_px, FOUND[0]);
        assert!((moved.sigma_px - 0.1 * FOUND[0]).abs() < 1e-9, "{moved:?}");
    }
}
