//! The incremental mapper: begin with a pair, add image after image, adjust as the model grows.
//!
//! After Schönberger & Frahm 2016. Everything random is drawn from streams keyed by (seed, images), every parallel step
//! collects in order: the result depends on the input, the options and the seed alone.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;

use tiepoint_geometry::{Loss, Rigid3, Rng};
use tiepoint_scene::{CameraId, CorrespondenceGraph, ImageId, ImagePair, PointId, Reconstruction};

use crate::adjust::{AdjustOptions, RefineIntrinsics, Scope, adjust, keep_going};
use crate::event::tell;
use crate::filter::{FilterOptions, filter_all_points, filter_images, filter_points};
use crate::focal::{FocalPrior, estimate_focal_lengths, focal_priors, with_focal};
use crate::initial_pair::{self, InitialPair, initial_pairs};
use crate::join::joined;
use crate::mounting::{Context, Descriptors, hold_to_mountings};
use crate::register::{RegisterOptions, register_image};
use crate::rig_pairs::{BaselineLink, RigPairs, final_links, growing_links, rig_pairs};
use crate::shutter::{Detected, Readout, estimate, known, straighten};
use crate::tracks::{TrackOptions, complete_tracks, merge_tracks, recreate_tracks, triangulate_image};
use crate::visibility::{Visibility, visibility};
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
    /// Of off, soft and hard the one that explains held-out tracks best; soft where they hardly differ.
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
    /// Of each weighted residual in an adjustment.
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

/// An image that could not be registered is tried again at most this often.
const MAX_REGISTER_TRIALS: usize = 3;
/// How many initial pairs are tried before giving up.
const MAX_INITIAL_TRIALS: usize = 20;
/// Initial pairs considered.
const MAX_CANDIDATES: usize = 400;
/// Images mapped from an initial pair to see whether it is sound, and how many pairs are tried so.
const MAX_START_IMAGES: usize = 7;
const MAX_STARTS: usize = 6;
/// A start that explains this share is taken at once: its rms error is below 0.5 px.
const GOOD_START_SHARE: f64 = 0.94;
/// Rounds of re-triangulation and adjustment in a global refinement while mapping, and at the end.
const GROWING_ROUNDS: usize = 1;
const FINAL_ROUNDS: usize = 5;
/// Rounds of the same between keypoints that a rolling shutter no longer shifts.
const STRAIGHT_ROUNDS: usize = 3;
/// A refinement is over when a round changes the number of observations and the cost by less than this share.
const MIN_CHANGE: f64 = 5e-4;
/// With fewer images the distortion is too weakly determined to be moved.
const MIN_IMAGES_FOR_DISTORTION: usize = 5;
/// Cameras that only move, without turning by this much (20°), hide their focal lengths and principal points: others stretch and
/// shear the world.
const MIN_TURN_RAD: f64 = 0.35;

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
        let mut mapper = Mapper {
            focal_priors: &focal_priors,
            rigs: &rigs,
            taken: taken.clone(),
            ..Mapper::new(graph, &scene, options)
        };
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
        let mut is_held = false;
        if let Some(model) = joined(&models[0], &models[index]) {
            let mut mapper =
                Mapper { model, focal_priors, is_final: true, ..Mapper::new(graph, &models[0], options) };
            // Told only if it is kept.
            let mut told = Vec::new();
            mapper.hold(descriptors, &mut |event| {
                told.push(event.clone());
                ControlFlow::Continue(())
            })?;
            is_held = told.iter().any(|event| matches!(event, Event::Mounted { hold: Some(_), .. }));
            if is_held {
                models[0] = mapper.model;
                tell(watch, &Event::Joined { num_images: models[0].num_registered() })?;
                told.iter().try_for_each(|event| tell(watch, event))?;
            }
        }
        if is_held {
            models.remove(index);
        } else {
            index += 1;
        }
    }
    Ok(())
}

/// Focal lengths that are tried where the pairs tell nothing, relative to the larger side of the image: 127° to 26° of view.
const FOCAL_HYPOTHESES: [f64; 8] = [0.25, 0.35, 0.5, 0.65, 0.85, 1.2, 1.6, 2.2];
/// Images in the model that each of them is tried on.
const MAX_TRIAL_IMAGES: usize = 14;
/// An observation off by this much speaks no longer for a hypothesis, in pixels.
const TRIAL_ERROR_PX: f64 = 2.0;
/// A hypothesis must explain this much more than the guess does.
const MIN_TRIAL_GAIN: f64 = 1.05;

/// Where neither the user nor EXIF nor the pairs tell the focal length, as on a straight drive, begins a model with each of several
/// and keeps the one that explains the most. All such cameras are given the same, relative to their images.
fn choose_focal_lengths(
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
        let mut mapper = Mapper { max_images: MAX_TRIAL_IMAGES, ..Mapper::new(graph, scene, options) };
        // A hypothesis under which nothing can be begun explains nothing.
        let _ = mapper.run(&mut |_| Vec::new(), &mut |_| ControlFlow::Continue(()));
        explained(&mapper.model).0
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

/// How many observations a model explains, less for those that it explains badly; and the same as a share of all.
fn explained(model: &Reconstruction) -> (f64, f64) {
    let errors =
        model.tracks().flat_map(|(_, t)| t.observations.iter().map(|o| model.error_of_px(o, &t.xyz)));
    let sum: f64 =
        errors.flatten().map(|error_px| (1.0 - (error_px / TRIAL_ERROR_PX).powi(2)).max(0.0)).sum();
    (sum, sum / model.num_observations().max(1) as f64)
}

/// One model in the making.
struct Mapper<'a> {
    graph: &'a CorrespondenceGraph,
    model: Reconstruction,
    options: &'a MapperOptions,
    focal_priors: &'a [FocalPrior],
    /// Cameras that are to be held to each other.
    rigs: &'a [RigPairs],
    /// Images of earlier models.
    taken: BTreeSet<ImageId>,
    /// How often each image failed to register.
    trials: BTreeMap<ImageId, usize>,
    /// The pair that the model began with.
    initial: Option<ImagePair>,
    /// Where to stop.
    max_images: usize,
    /// Whether all images that can be registered are.
    is_final: bool,
}

impl<'a> Mapper<'a> {
    fn new(graph: &'a CorrespondenceGraph, scene: &Reconstruction, options: &'a MapperOptions) -> Self {
        Self {
            graph,
            model: scene.clone(),
            options,
            focal_priors: &[],
            rigs: &[],
            taken: BTreeSet::new(),
            trials: BTreeMap::new(),
            initial: None,
            max_images: usize::MAX,
            is_final: false,
        }
    }

    fn run(
        &mut self,
        descriptors: &mut Descriptors,
        watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        let candidates = self.candidates();
        let is_trial = self.max_images < usize::MAX;
        match if is_trial { None } else { self.best_start(&candidates) } {
            Some(pair) => self.initialise(&[pair], watch)?,
            None => self.initialise(&candidates, watch)?,
        }
        self.grow(watch)?;
        if is_trial {
            return Ok(());
        }
        self.is_final = true;
        self.refine_globally(FINAL_ROUNDS, 1e-8, 100, watch)?;
        if let Some(readout) = self.options.readout {
            self.straighten(readout, watch)?;
        }
        match self.options.rig {
            RigTerm::Paper => {
                let links = final_links(&self.model, self.rigs);
                self.adjust_globally(&links, 1e-8, 100, watch)?;
            }
            RigTerm::Soft | RigTerm::Hard | RigTerm::Auto => self.hold(descriptors, watch)?,
            RigTerm::Off => {}
        }
        Ok(())
    }

    /// Holds the cameras of the finished model to their mountings.
    fn hold(
        &mut self,
        descriptors: &mut Descriptors,
        watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        let mut model = self.model.clone();
        let context = Context {
            graph: self.graph,
            tracks: &self.options.tracks,
            filter: &self.options.filter,
            adjust: self.adjust_options(&[], 1e-8, 100),
            seed: self.options.seed,
        };
        hold_to_mountings(&context, &mut model, self.options.rig, descriptors, watch)?;
        self.model = model;
        Ok(())
    }

    /// Takes off the keypoints what a rolling shutter did to them, and refines the model with what is left.
    fn straighten(
        &mut self,
        readout: Readout,
        watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        let detected = Detected::of(&self.model);
        let shutters = match readout {
            Readout::Known(readout_s) => known(&self.model, readout_s),
            Readout::Estimated => {
                let options = self.adjust_options(&[], 1e-8, 100);
                estimate(&mut self.model, &detected, &options)?
            }
        };
        for _ in 0..STRAIGHT_ROUNDS {
            straighten(&mut self.model, &detected, &shutters);
            self.refine_globally(1, 1e-8, 100, watch)?;
        }
        shutters.into_iter().try_for_each(|shutter| tell(watch, &Event::Shutter(shutter)))
    }

    /// Registers all images that can be, adjusting as the model grows.
    fn grow(&mut self, watch: &mut dyn FnMut(&Event) -> ControlFlow<()>) -> Result<(), Error> {
        let mut images_at_global = self.model.num_registered();
        let mut points_at_global = self.model.num_tracks();
        loop {
            while let Some(image) = self.register_next() {
                triangulate_image(self.graph, &mut self.model, image, &self.options.tracks);
                self.adjust_locally(image)?;
                self.report(image, watch)?;
                let (images, points) = (self.model.num_registered(), self.model.num_tracks());
                let grown = |now: usize, then: usize| now as f64 >= self.options.global_growth * then as f64;
                if grown(images, images_at_global) || grown(points, points_at_global) {
                    self.refine_globally(GROWING_ROUNDS, 1e-5, 30, watch)?;
                    (images_at_global, points_at_global) =
                        (self.model.num_registered(), self.model.num_tracks());
                }
            }
            // What fails before the last refinement may succeed after it.
            self.refine_globally(GROWING_ROUNDS, 1e-5, 30, watch)?;
            self.trials.clear();
            if !self.try_remaining()? {
                return Ok(());
            }
        }
    }

    /// Registers one of the images that failed before, if any can be now.
    fn try_remaining(&mut self) -> Result<bool, Error> {
        match self.register_next() {
            Some(image) => {
                triangulate_image(self.graph, &mut self.model, image, &self.options.tracks);
                self.adjust_locally(image)?;
                Ok(true)
            }
            None => Ok(false),
        }
    }

    fn remaining(&self) -> Vec<ImageId> {
        let is_open = |id: &ImageId| !self.taken.contains(id);
        self.model
            .images()
            .filter(|(id, image)| is_open(id) && image.cam_from_world().is_none())
            .map(|(id, _)| id)
            .collect()
    }

    /// Pairs to begin with, the best first.
    fn candidates(&self) -> Vec<InitialPair> {
        let is_free = |pair: ImagePair| !self.taken.contains(&pair.a) && !self.taken.contains(&pair.b);
        let max_error_px = self.options.filter.max_error_px;
        initial_pairs(self.graph, &self.model, &is_free, max_error_px, MAX_CANDIDATES)
    }

    /// Texture that repeats fools pairs: they agree on wrong depths, and only further images tell. So a few images are mapped from
    /// the best pair, and unless they fit well, from others elsewhere, and the pair that explains the most is taken.
    fn best_start(&self, candidates: &[InitialPair]) -> Option<InitialPair> {
        let options = &MapperOptions { refine: RefineIntrinsics::NONE, ..*self.options };
        let mut tried: Vec<ImageId> = Vec::new();
        let mut best: Option<(f64, InitialPair)> = None;
        for candidate in candidates {
            let images = [candidate.pair.a, candidate.pair.b];
            let is_near = |a: ImageId, b: ImageId| {
                a == b || ImagePair::new(a, b).is_some_and(|pair| self.graph.pairs().contains_key(&pair))
            };
            if tried.iter().any(|&other| images.iter().any(|&image| is_near(image, other))) {
                continue;
            }
            let mut trial = Mapper {
                taken: self.taken.clone(),
                max_images: MAX_START_IMAGES,
                ..Mapper::new(self.graph, &self.model, options)
            };
            if trial.initialise(&[*candidate], &mut |_| ControlFlow::Continue(())).is_err() {
                continue;
            }
            // What a failed trial has reached counts.
            let _ = trial.grow(&mut |_| ControlFlow::Continue(()));
            tried.extend(images);
            let (score, share) = explained(&trial.model);
            if best.as_ref().is_none_or(|(most, _)| score > *most) {
                best = Some((score, *candidate));
            }
            if share > GOOD_START_SHARE || tried.len() == 2 * MAX_STARTS {
                break;
            }
        }
        best.map(|(_, candidate)| candidate)
    }

    fn initialise(
        &mut self,
        candidates: &[InitialPair],
        watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        let start = self.model.clone();
        let mut most = 0;
        for candidate in candidates.iter().take(MAX_INITIAL_TRIALS) {
            let pair = candidate.pair;
            let seed = self.seed_of(&[u64::from(pair.a.0), u64::from(pair.b.0)]);
            let Some(cam2_from_cam1) = initial_pair::refine(self.graph, &self.model, pair, seed) else {
                continue;
            };
            self.model.register(pair.a, Rigid3::identity());
            self.model.register(pair.b, cam2_from_cam1);
            self.initial = Some(pair);
            triangulate_image(self.graph, &mut self.model, pair.a, &self.options.tracks);
            let options = self.adjust_options(&[], 1e-5, 50);
            let adjusted = adjust(&mut self.model, &Scope::Global, &options, &mut keep_going);
            filter_all_points(&mut self.model, &self.options.filter);
            most = most.max(self.model.num_tracks());
            if adjusted.is_ok() && self.model.num_tracks() >= self.options.min_initial_inliers {
                let num_points = self.model.num_tracks();
                return tell(watch, &Event::Initialised { image1: pair.a, image2: pair.b, num_points });
            }
            self.model = start.clone();
        }
        Err(Error::NoInitialPair {
            verified: self.graph.pairs().len(),
            best_inliers: most,
            required: self.options.min_initial_inliers,
        })
    }

    /// Registers the image that sees the most of the model, best spread; `None` when none can be.
    fn register_next(&mut self) -> Option<ImageId> {
        if self.model.num_registered() >= self.max_images {
            return None;
        }
        let mut candidates: Vec<(Visibility, ImageId)> = self
            .remaining()
            .into_iter()
            .filter(|id| self.trials.get(id).copied().unwrap_or(0) < MAX_REGISTER_TRIALS)
            .map(|id| (visibility(self.graph, &self.model, id), id))
            .filter(|(seen, _)| seen.num_points >= self.options.register.min_num_inliers)
            .collect();
        candidates.sort_by_key(|(seen, id)| (std::cmp::Reverse(seen.score), *id));
        for (_, image) in candidates {
            let seed = self.seed_of(&[u64::from(image.0), self.model.num_registered() as u64]);
            if register_image(self.graph, &mut self.model, image, &self.options.register, seed).is_some() {
                return Some(image);
            }
            *self.trials.entry(image).or_insert(0) += 1;
        }
        None
    }

    /// Adjusts a new image with the images that share most points with it.
    fn adjust_locally(&mut self, image: ImageId) -> Result<(), Error> {
        let mut shared: BTreeMap<ImageId, usize> = BTreeMap::new();
        for track in self.model.image(image).points().iter().flatten().filter_map(|p| self.model.track(*p)) {
            for observation in track.observations.iter().filter(|o| o.image != image) {
                *shared.entry(observation.image).or_insert(0) += 1;
            }
        }
        let mut neighbours: Vec<(usize, ImageId)> =
            shared.into_iter().map(|(id, count)| (count, id)).collect();
        neighbours.sort_by_key(|(count, id)| (std::cmp::Reverse(*count), *id));
        let bundle: BTreeSet<ImageId> = std::iter::once(image)
            .chain(neighbours.into_iter().map(|(_, id)| id).take(self.options.local_images - 1))
            .collect();
        let links = growing_links(&self.model, self.rigs);
        let options = self.adjust_options(&links, 1e-4, 25);
        match adjust(&mut self.model, &Scope::Local(&bundle), &options, &mut keep_going) {
            Ok(_) | Err(Error::NothingToAdjust { .. }) => {}
            Err(error) => return Err(error),
        }
        let points: Vec<PointId> = self.points_of(&bundle);
        complete_tracks(self.graph, &mut self.model, &points, &self.options.tracks);
        merge_tracks(self.graph, &mut self.model, &points, &self.options.tracks);
        let points = self.points_of(&bundle);
        filter_points(&mut self.model, &points, &self.options.filter);
        Ok(())
    }

    fn points_of(&self, images: &BTreeSet<ImageId>) -> Vec<PointId> {
        let points: BTreeSet<PointId> =
            images.iter().flat_map(|id| self.model.image(*id).points().iter().flatten().copied()).collect();
        points.into_iter().collect()
    }

    /// Re-triangulates, completes, merges, adjusts and filters everything until little changes.
    fn refine_globally(
        &mut self,
        rounds: usize,
        function_tolerance: f64,
        max_iterations: usize,
        watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        let mut before = (self.model.num_observations(), f64::INFINITY);
        for _ in 0..rounds {
            recreate_tracks(self.graph, &mut self.model, &self.options.tracks);
            let links = growing_links(&self.model, self.rigs);
            let after = self.adjust_globally(&links, function_tolerance, max_iterations, watch)?;
            let changed = |now: f64, then: f64| (now - then).abs() >= MIN_CHANGE * now.abs();
            if !changed(after.0 as f64, before.0 as f64) && !changed(after.1, before.1) {
                break;
            }
            before = after;
        }
        Ok(())
    }

    /// Adjusts and filters everything. Returns the number of observations and the cost.
    fn adjust_globally(
        &mut self,
        links: &[BaselineLink],
        function_tolerance: f64,
        max_iterations: usize,
        watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
    ) -> Result<(usize, f64), Error> {
        let options = self.adjust_options(links, function_tolerance, max_iterations);
        let summary = adjust(&mut self.model, &Scope::Global, &options, &mut keep_going)?;
        filter_all_points(&mut self.model, &self.options.filter);
        filter_images(&mut self.model, self.options.register.min_num_inliers / 2);
        let (num_observations, cost) = (self.model.num_observations(), summary.final_cost);
        let (num_images, iterations) = (self.model.num_registered(), summary.iterations.len());
        tell(watch, &Event::Adjusted { num_images, num_observations, cost, iterations })?;
        Ok((num_observations, cost))
    }

    fn adjust_options<'l>(
        &self,
        links: &'l [BaselineLink],
        function_tolerance: f64,
        max_iterations: usize,
    ) -> AdjustOptions<'l>
    where
        Self: 'l,
    {
        let mut refine = self.options.refine;
        let turns = self.turns();
        refine.focal &= self.is_final || turns;
        refine.principal_point &= self.is_final && turns;
        if self.model.num_registered() < MIN_IMAGES_FOR_DISTORTION {
            refine = RefineIntrinsics { focal: refine.focal, ..RefineIntrinsics::NONE };
        }
        if self.model.num_registered() < 3 {
            refine = RefineIntrinsics::NONE;
        }
        AdjustOptions {
            refine,
            loss: self.options.loss,
            focal_priors: self.focal_priors,
            links,
            gauge: self.initial.filter(|_| self.options.rig == RigTerm::Paper),
            max_iterations,
            function_tolerance,
            ..AdjustOptions::default()
        }
    }

    /// Whether some image looks elsewhere than the first one.
    fn turns(&self) -> bool {
        let mut poses = self.model.registered().map(|(.., pose)| pose.rotation);
        poses.next().is_some_and(|first| poses.any(|rotation| rotation.angle_to(&first) > MIN_TURN_RAD))
    }

    fn seed_of(&self, key: &[u64]) -> u64 {
        Rng::stream(self.options.seed, key).next_u64()
    }

    fn report(&self, image: ImageId, watch: &mut dyn FnMut(&Event) -> ControlFlow<()>) -> Result<(), Error> {
        let event = Event::Registered {
            image,
            num_registered: self.model.num_registered(),
            num_images: self.model.images().count() - self.taken.len(),
            num_points: self.model.num_tracks(),
        };
        tell(watch, &event)
    }
}
