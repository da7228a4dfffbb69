//! The incremental mapper: begin with a pair, add image after image, adjust as the model grows.
//!
//! After Schönberger & Frahm 2016. Everything random is drawn from streams keyed by (seed, images), every parallel step
//! collects in order: the result depends on the input, the options and the seed alone.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;

use tiepoint_geometry::{Loss, Rigid3, Rng};
use tiepoint_scene::{CameraId, CorrespondenceGraph, ImageId, ImagePair, PointId, Reconstruction};

use crate::adjust::{AdjustOptions, RefineIntrinsics, Scope, adjust};
use crate::filter::{FilterOptions, filter_all_points, filter_images, filter_points};
use crate::focal::{FocalPrior, estimate_focal_lengths, focal_priors};
use crate::initial_pair::{self, initial_pairs};
use crate::register::{RegisterOptions, register_image};
use crate::rig_pairs::{BaselineLink, RigPairs, final_links, growing_links, rig_pairs};
use crate::tracks::{TrackOptions, complete_tracks, merge_tracks, retriangulate, triangulate_image};
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
            seed: 0,
        }
    }
}

/// An image that could not be registered is tried again at most this often.
const MAX_REGISTER_TRIALS: usize = 3;
/// How many initial pairs are tried before giving up.
const MAX_INITIAL_TRIALS: usize = 20;
/// Rounds of re-triangulation and adjustment in a global refinement while mapping, and at the end.
const GROWING_ROUNDS: usize = 1;
const FINAL_ROUNDS: usize = 5;
/// A refinement is over when a round changes the number of observations and the cost by less than this share.
const MIN_CHANGE: f64 = 5e-4;
/// With fewer images the distortion and the principal point are too weakly determined to be moved.
const MIN_IMAGES_FOR_FULL_INTRINSICS: usize = 5;

/// Maps all images that hang together, one model for each connected part, the one with the most images first. `scene` gives the
/// cameras and the images with their keypoints; poses and points in it are ignored.
pub fn map(
    graph: &CorrespondenceGraph,
    scene: &Reconstruction,
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
        RigTerm::Off => Vec::new(),
        RigTerm::Paper => rig_pairs(&scene),
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
        match mapper.run(watch) {
            Ok(()) => {}
            Err(Error::NoInitialPair { .. }) if !models.is_empty() => break,
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
    Ok(models)
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
        let _ = mapper.run(&mut |_| ControlFlow::Continue(()));
        let share = |error_px: f64| (1.0 - (error_px / TRIAL_ERROR_PX).powi(2)).max(0.0);
        let model = &mapper.model;
        let errors =
            model.tracks().flat_map(|(_, t)| t.observations.iter().map(|o| model.error_of_px(o, &t.xyz)));
        errors.flatten().map(share).sum()
    };
    let with = |scene: &Reconstruction, relative: f64| {
        let mut changed = scene.clone();
        for &id in &unknown {
            let camera = changed.camera_mut(id);
            let focal_px = relative * f64::from(camera.width.max(camera.height));
            for &param in camera.intrinsics.kind().focal_indices() {
                camera.intrinsics.params_mut()[param] = focal_px;
            }
        }
        changed
    };
    let guess = explained(scene);
    let mut best = (MIN_TRIAL_GAIN * guess, scene.clone());
    for relative in FOCAL_HYPOTHESES {
        let candidate = with(scene, relative);
        let score = explained(&candidate);
        if score > best.0 {
            best = (score, candidate);
        }
    }
    *scene = best.1;
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
        }
    }

    fn run(&mut self, watch: &mut dyn FnMut(&Event) -> ControlFlow<()>) -> Result<(), Error> {
        self.initialise(watch)?;
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
                break;
            }
        }
        self.refine_globally(FINAL_ROUNDS, 1e-8, 100, watch)?;
        if !self.rigs.is_empty() {
            let links = final_links(&self.model, self.rigs);
            self.adjust_globally(&links, 1e-8, 100, watch)?;
        }
        Ok(())
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

    fn initialise(&mut self, watch: &mut dyn FnMut(&Event) -> ControlFlow<()>) -> Result<(), Error> {
        let taken = self.taken.clone();
        let is_free = |pair: ImagePair| !taken.contains(&pair.a) && !taken.contains(&pair.b);
        let max_error_px = self.options.filter.max_error_px;
        let candidates = initial_pairs(self.graph, &self.model, &is_free, max_error_px, MAX_INITIAL_TRIALS);
        let start = self.model.clone();
        let mut most = 0;
        for candidate in &candidates {
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
            retriangulate(self.graph, &mut self.model, &self.options.tracks);
            let points: Vec<PointId> = self.model.tracks().map(|(point, _)| point).collect();
            complete_tracks(self.graph, &mut self.model, &points, &self.options.tracks);
            merge_tracks(self.graph, &mut self.model, &points, &self.options.tracks);
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
        if self.model.num_registered() < MIN_IMAGES_FOR_FULL_INTRINSICS {
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

fn keep_going(_: &tiepoint_ba::IterationRecord) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn tell(watch: &mut dyn FnMut(&Event) -> ControlFlow<()>, event: &Event) -> Result<(), Error> {
    match watch(event) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Cancelled),
    }
}
