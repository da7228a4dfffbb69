//! One model in the making: begin with a pair, add image after image, adjust as the model grows.
//!
//! After Schönberger & Frahm 2016. Everything random is drawn from streams keyed by (seed, images), every parallel step
//! collects in order: the result depends on the input, the options and the seed alone.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;

use rayon::prelude::*;
use tiepoint_geometry::{Rigid3, Rng};
use tiepoint_scene::{CorrespondenceGraph, ImageId, ImagePair, Reconstruction};

use crate::adjust::{AdjustOptions, RefineIntrinsics, Scope, adjust, keep_going};
use crate::effort::Effort;
use crate::event::{Finish, tell};
use crate::filter::{filter_all_points, filter_images, filter_points};
use crate::focal::FocalPrior;
use crate::focal_trials::explained;
use crate::incremental::{MapperOptions, RigTerm};
use crate::initial_pair::{self, InitialPair, initial_pairs};
use crate::loop_closure::{Joined, MIN_PAIRS, Pairs, is_closed, join, pairs};
use crate::mounting::{Context, Descriptors, hold_to_mountings};
use crate::next_image::Queue;
use crate::pose_graph::{Meeting, agreeing, spread_drift};
use crate::rig_pairs::{BaselineLink, RigPairs, final_links, growing_links};
use crate::shutter::RollingShutters;
use crate::sigma::relative_noise;
use crate::tracks::{complete_tracks, merge_tracks, recreate_tracks, triangulate_image};
use crate::{Error, Event};

/// How many initial pairs are tried before giving up.
const MAX_INITIAL_TRIALS: usize = 20;
/// Initial pairs considered.
const MAX_CANDIDATES: usize = 400;
/// Images mapped from an initial pair to see whether it is sound, and how many pairs are tried so.
const MAX_START_IMAGES: usize = 7;
const MAX_STARTS: usize = 6;
/// A start that explains this share is taken at once: its rms error is below 0.5 px.
const GOOD_START_SHARE: f64 = 0.94;
/// How often loops are closed: one that is hides another.
const MAX_CLOSURES: usize = 3;
/// How often keypoints are straightened by the model in the end, and the model made by them.
const STRAIGHT_ROUNDS: usize = 3;
/// Of the images at least this share is left then: a readout that cannot be leaves hardly any, since what it shifts agrees with nothing.
const MIN_STRAIGHTENED: f64 = 0.5;
/// A refinement is over when a round changes the number of observations and the cost by less than this share.
const MIN_CHANGE: f64 = 5e-4;
/// With fewer images the distortion is too weakly determined to be moved.
const MIN_IMAGES_FOR_DISTORTION: usize = 5;
/// Cameras that only move, without turning by this much (20°), hide their focal lengths and principal points: others stretch and
/// shear the world.
const MIN_TURN_RAD: f64 = 0.35;

/// One model in the making.
pub(crate) struct Mapper<'a> {
    graph: &'a CorrespondenceGraph,
    pub(crate) model: Reconstruction,
    options: &'a MapperOptions,
    pub(crate) focal_priors: &'a [FocalPrior],
    /// Cameras that are to be held to each other.
    pub(crate) rigs: &'a [RigPairs],
    /// Images of earlier models.
    pub(crate) taken: BTreeSet<ImageId>,
    queue: Queue,
    /// The pair that the model began with.
    initial: Option<ImagePair>,
    /// Where to stop.
    pub(crate) max_images: usize,
    /// Of the keypoints, as a multiple of what is expected; once all images that can be are registered.
    noise: Option<f64>,
}

impl<'a> Mapper<'a> {
    pub(crate) fn new(
        graph: &'a CorrespondenceGraph,
        scene: &Reconstruction,
        options: &'a MapperOptions,
    ) -> Self {
        Self {
            graph,
            model: scene.clone(),
            options,
            focal_priors: &[],
            rigs: &[],
            taken: BTreeSet::new(),
            queue: Queue::new(scene, options.seed),
            initial: None,
            max_images: usize::MAX,
            noise: None,
        }
    }

    pub(crate) fn run(
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
        self.weigh();
        self.refine_globally(&Effort::GROWN, watch)?;
        let mut shutters = self.options.readout.map(|readout| RollingShutters::new(&self.model, readout));
        // Before loops are closed: a rolling shutter makes a drive grow or shrink on its way, sevenfold in 2 km, and no loop closes over that.
        self.straighten(&mut shutters, false, watch)?;
        self.close_loops(watch)?;
        self.weigh();
        self.refine_globally(&Effort::FINAL, watch)?;
        self.straighten(&mut shutters, true, watch)?;
        if let Some(shutters) = &shutters {
            shutters.get().iter().try_for_each(|shutter| tell(watch, &Event::Shutter(*shutter)))?;
        }
        match self.options.rig {
            RigTerm::Paper => self.finish(Finish::Held, watch, |mapper, watch| {
                let links = final_links(&mapper.model, mapper.rigs);
                mapper.adjust_globally(&links, &Effort::FINAL, watch).map(|_| ())
            }),
            RigTerm::Soft | RigTerm::Hard | RigTerm::Auto => {
                self.finish(Finish::Held, watch, |mapper, watch| mapper.hold(descriptors, watch))
            }
            RigTerm::Off => Ok(()),
        }
    }

    /// Makes something more of a finished model, which stays as it was where that fails.
    fn finish(
        &mut self,
        finish: Finish,
        watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
        work: impl FnOnce(&mut Self, &mut dyn FnMut(&Event) -> ControlFlow<()>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let (model, noise) = (self.model.clone(), self.noise);
        match work(self, watch) {
            Ok(()) => Ok(()),
            Err(Error::Cancelled) => Err(Error::Cancelled),
            Err(error) => {
                (self.model, self.noise) = (model, noise);
                tell(watch, &Event::Failed { finish, why: error.to_string() })
            }
        }
    }

    /// From here on keypoints weigh by the noise that they have now.
    pub(crate) fn weigh(&mut self) {
        self.noise = Some(relative_noise(&self.model));
    }

    /// Closes loops that the mapping has left open ([`crate::loop_closure`]).
    fn close_loops(&mut self, watch: &mut dyn FnMut(&Event) -> ControlFlow<()>) -> Result<(), Error> {
        for _ in 0..MAX_CLOSURES {
            let Pairs { torn, joined } = pairs(self.graph, &self.model);
            let meetings = self.meetings(&torn, &joined);
            if meetings.len() < MIN_PAIRS {
                break;
            }
            let torn: Vec<ImagePair> = meetings.iter().map(|meeting| meeting.pair).collect();
            let before = self.model.clone();
            match self.close_loop(&joined, &meetings, watch) {
                Ok(()) if is_closed(self.graph, &self.model, &before, &torn) => {}
                Err(Error::Cancelled) => return Err(Error::Cancelled),
                // What tears them is not drift. Where the pairs are wrong, or the lens is, closing may leave nothing to adjust.
                Ok(()) | Err(_) => {
                    self.model = before;
                    break;
                }
            }
            tell(watch, &Event::LoopClosed { num_pairs: torn.len() })?;
        }
        Ok(())
    }

    /// How the images of torn pairs should stand to each other.
    fn meetings(&self, torn: &[ImagePair], joined: &Joined) -> Vec<Meeting> {
        let meeting = |pair: &ImagePair| {
            let seed = self.seed_of(&[pair.a.0.into(), pair.b.0.into()]);
            Meeting::new(&self.model, *pair, self.graph.pairs().get(pair)?, seed)
        };
        let meetings: Vec<Meeting> = torn.par_iter().filter_map(meeting).collect();
        agreeing(&self.model, &meetings, joined)
    }

    /// Spreads over the model what it takes for pairs to meet, and makes their matches one point each.
    fn close_loop(
        &mut self,
        joined: &Joined,
        meetings: &[Meeting],
        watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        spread_drift(&mut self.model, joined, meetings)?;
        join(self.graph, &mut self.model, meetings.iter().map(|meeting| meeting.pair));
        self.refine_globally(&Effort::CLOSED, watch)
    }

    /// Holds the cameras of the finished model to their mountings.
    pub(crate) fn hold(
        &mut self,
        descriptors: &mut Descriptors,
        watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        let context = Context {
            graph: self.graph,
            tracks: &self.options.tracks,
            filter: &self.options.filter,
            adjust: self.adjust_options(&[], &Effort::HOLDING),
            seed: self.options.seed,
        };
        hold_to_mountings(&context, &mut self.model, self.options.rig, descriptors, watch)
    }

    /// Takes off the keypoints what rolling shutters did to them, and refines the model with what is left. Where that fails, the shutters are left
    /// alone from then on, or as they were found before.
    fn straighten(
        &mut self,
        shutters: &mut Option<RollingShutters>,
        is_last: bool,
        watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        let Some(mut found) = shutters.take() else { return Ok(()) };
        let (effort, rounds) =
            if is_last { (&Effort::STRAIGHTENED, STRAIGHT_ROUNDS) } else { (&Effort::GROWN, 1) };
        let (earlier, mut is_done) = (found.get().to_vec(), false);
        self.finish(Finish::Straightened, watch, |mapper, watch| {
            let (options, before) = (mapper.adjust_options(&[], effort), mapper.model.num_registered());
            found.find(&mut mapper.model, &options)?;
            if is_last {
                found.find_deviations(&mapper.model, &options)?;
            }
            for round in 0..rounds {
                if round > 0 {
                    found.take_off(&mut mapper.model);
                }
                mapper.weigh();
                mapper.refine_globally(effort, watch)?;
            }
            let after = mapper.model.num_registered();
            if (after as f64) < MIN_STRAIGHTENED * before as f64 {
                return Err(Error::ImagesLost { before, after });
            }
            is_done = true;
            Ok(())
        })?;
        if !is_done && is_last {
            // What was taken off before still is.
            found.set(earlier);
        }
        *shutters = (is_done || is_last).then_some(found);
        Ok(())
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
                    self.refine_globally(&Effort::GROWING, watch)?;
                    (images_at_global, points_at_global) =
                        (self.model.num_registered(), self.model.num_tracks());
                }
            }
            // What fails before the last refinement may succeed after it.
            self.refine_globally(&Effort::GROWING, watch)?;
            self.queue.forgive();
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

    /// Images that are not registered and have a verified pair with one that is: no other sees anything of the model.
    fn frontier(&self) -> Vec<ImageId> {
        let has_pose = |id: &ImageId| self.model.image(*id).cam_from_world().is_some();
        let is_open = |id: &ImageId| !self.taken.contains(id) && !has_pose(id);
        let is_next = |id: &ImageId| self.graph.neighbours(*id).iter().any(has_pose);
        self.model.images().map(|(id, _)| id).filter(is_open).filter(is_next).collect()
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
            let is_near = |a: ImageId, b: ImageId| a == b || self.graph.neighbours(a).contains(&b);
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
            let options = self.adjust_options(&[], &Effort::INITIAL);
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

    /// Registers one more image; `None` when none can be.
    fn register_next(&mut self) -> Option<ImageId> {
        if self.model.num_registered() >= self.max_images {
            return None;
        }
        let images = self.frontier();
        self.queue.register_next(self.graph, &mut self.model, images, &self.options.register)
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
        let options = self.adjust_options(&links, &Effort::LOCAL);
        match adjust(&mut self.model, &Scope::Local(&bundle), &options, &mut keep_going) {
            Ok(_) | Err(Error::NothingToAdjust { .. }) => {}
            Err(error) => return Err(error),
        }
        let points = self.model.points_seen_by(&bundle);
        complete_tracks(self.graph, &mut self.model, &points, &self.options.tracks);
        merge_tracks(self.graph, &mut self.model, &points, &self.options.tracks);
        let points = self.model.points_seen_by(&bundle);
        filter_points(&mut self.model, &points, &self.options.filter);
        Ok(())
    }

    /// Re-triangulates, completes, merges, adjusts and filters everything until little changes.
    fn refine_globally(
        &mut self,
        effort: &Effort,
        watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        let mut before = (self.model.num_observations(), f64::INFINITY);
        for _ in 0..effort.rounds {
            recreate_tracks(self.graph, &mut self.model, &self.options.tracks);
            let links = growing_links(&self.model, self.rigs);
            let after = self.adjust_globally(&links, effort, watch)?;
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
        effort: &Effort,
        watch: &mut dyn FnMut(&Event) -> ControlFlow<()>,
    ) -> Result<(usize, f64), Error> {
        let options = self.adjust_options(links, effort);
        let summary = adjust(&mut self.model, &Scope::Global, &options, &mut keep_going)?;
        filter_all_points(&mut self.model, &self.options.filter);
        filter_images(&mut self.model, self.options.register.min_num_inliers / 2);
        let (num_observations, cost) = (self.model.num_observations(), summary.final_cost);
        let (num_images, iterations) = (self.model.num_registered(), summary.iterations.len());
        tell(watch, &Event::Adjusted { num_images, num_observations, cost, iterations })?;
        Ok((num_observations, cost))
    }

    fn adjust_options<'l>(&self, links: &'l [BaselineLink], effort: &Effort) -> AdjustOptions<'l>
    where
        Self: 'l,
    {
        let mut refine = self.options.refine;
        let turns = self.turns();
        refine.focal &= self.noise.is_some() || turns;
        refine.principal_point &= self.noise.is_some() && turns;
        if self.model.num_registered() < MIN_IMAGES_FOR_DISTORTION {
            refine = RefineIntrinsics { focal: refine.focal, ..RefineIntrinsics::NONE };
        }
        if self.model.num_registered() < 3 {
            refine = RefineIntrinsics::NONE;
        }
        let options = AdjustOptions {
            refine,
            spread: effort.spread,
            loss: self.options.loss,
            focal_priors: self.focal_priors,
            links,
            gauge: self.initial.filter(|_| self.options.rig == RigTerm::Paper),
            max_iterations: effort.max_iterations,
            function_tolerance: effort.tolerance,
            ..AdjustOptions::default()
        };
        match self.noise {
            Some(noise) => options.with_noise(noise),
            // While it grows, a model is worse than its keypoints.
            None => options,
        }
    }

    /// Whether some image looks elsewhere than the first one of its camera: two cameras on one mount look apart without ever turning. Where
    /// each image has a camera of its own, photos are compared with each other.
    fn turns(&self) -> bool {
        let is_shared = self.model.cameras().count() < self.model.images().count();
        let mut first = BTreeMap::new();
        self.model.registered().any(|(_, image, pose)| {
            let camera = is_shared.then_some(image.camera);
            first.entry(camera).or_insert(pose.rotation).angle_to(&pose.rotation) > MIN_TURN_RAD
        })
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

#[cfg(test)]
mod tests {
    use tiepoint_scene::{Match, TwoView, TwoViewKind};
    use tiepoint_synth::{Drive, DriveOptions, FeatureOptions, FeatureScene, MatchOptions};

    use super::*;

    const IMAGES: usize = 8;
    const OBSERVATIONS: usize = 200;

    /// Every pair of images is said to see the same where it does not: nothing is left of the model then, but what was before.
    #[test]
    fn a_loop_that_cannot_be_closed_leaves_the_model_as_it_was() {
        let mut drive =
            Drive::new(&DriveOptions { rate_hz: 4.0, ..DriveOptions::default() }).expect("a drive");
        drive.keep_first(IMAGES);
        let features =
            FeatureOptions { observations: 2 * IMAGES * OBSERVATIONS, ..FeatureOptions::default() };
        let scene = FeatureScene::new(&drive, &features).expect("sound options");
        let graph = scene.graph(&MatchOptions::default());
        let options = MapperOptions { refine: RefineIntrinsics::NONE, ..MapperOptions::default() };
        let blank = scene.without_poses();
        let mut mapper = Mapper::new(&graph, &blank, &options);
        let watch = &mut |_: &Event| ControlFlow::Continue(());
        mapper.run(&mut |_| Vec::new(), watch).expect("an easy scene");
        let model = mapper.model.clone();

        let seen = |id: ImageId| -> Vec<u32> {
            (0..).zip(model.image(id).points()).filter_map(|(k, point)| point.map(|_| k)).collect()
        };
        let wrong = graph.pairs().keys().map(|&pair| {
            // What one sees first, the other sees last.
            let (a, b) = (seen(pair.a).into_iter(), seen(pair.b).into_iter().rev());
            let matches = a.zip(b).map(|(a, b)| Match { a, b }).collect();
            (pair, TwoView { kind: TwoViewKind::Uncalibrated, matches, ..TwoView::default() })
        });
        let graph = graph.extended(wrong);
        let mut mapper = Mapper { model: model.clone(), ..Mapper::new(&graph, &blank, &options) };
        assert!(!pairs(&graph, &model).torn.is_empty());
        mapper.close_loops(watch).expect("no reason to end the run");
        assert!(mapper.model == model);
    }
}
