//! Next-best-view selection: the image with the best visibility score (Schönberger & Frahm 2016),
//! unless it is deferred.
//!
//! With repeated texture, wrong matches that agree with each other register images at wrong poses,
//! and later images follow them. Correct neighbours prevent this, so they come first: an image
//! waits for candidates between it and the model in time, and an image with low visible-point
//! recall or an implausible motion is deferred until no other candidate is left.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use tiepoint_geometry::Rng;
use tiepoint_geometry::numeric::median;
use tiepoint_scene::{CorrespondenceGraph, ImageId, Reconstruction};

use super::absolute_pose::{Placement, RegistrationUnit, estimate_placement};
use super::continuity::Timelines;
use super::evidence::Evidence;
use super::options::RegisterOptions;
use super::recall::Recall;
use super::visibility::{Visibility, visibility};
use crate::known_frames::KnownFrames;
use crate::saved::saved;

/// Maximum number of failed registrations of an image between resets, and of registrations of an
/// image that filtering removed again.
const MAX_TRIALS: usize = 3;
/// A deferred image is placed again when the number of its visible points has grown by this factor.
const MIN_GROWTH: f64 = 1.1;
/// An image is deferred if its visible-point recall is below this fraction of the median of its
/// neighbours. Correct images have 0.76 and more; images registered at a wrong window 0.49 to 0.75.
const MIN_RELATIVE_RECALL: f64 = 0.75;

/// State of the selection.
pub(crate) struct NextBestView {
    seed: u64,
    timelines: Timelines,
    /// Frames that are registered as a whole. In all tables the first image of a frame stands for
    /// it.
    frames: KnownFrames,
    /// Failed registrations of each image.
    trials: BTreeMap<ImageId, usize>,
    /// Registrations of each image. The limit prevents endless registration and filtering.
    registrations: BTreeMap<ImageId, usize>,
    /// Visible-point recall of each image at its registration; `None` if too few points tell it.
    recalls: BTreeMap<ImageId, Option<f64>>,
    /// Deferred images.
    deferred: BTreeMap<ImageId, DeferredImage>,
}

/// What the selection remembers of its attempts.
#[derive(Clone)]
pub(crate) struct History {
    trials: BTreeMap<ImageId, usize>,
    registrations: BTreeMap<ImageId, usize>,
    recalls: BTreeMap<ImageId, Option<f64>>,
    deferred: BTreeMap<ImageId, DeferredImage>,
}

saved! { struct History { trials, registrations, recalls, deferred } }

/// An image that could be registered, but waits for others.
#[derive(Clone, Copy, Debug)]
struct DeferredImage {
    /// Number of visible points when it was placed.
    num_points: usize,
    /// Visible-point recall relative to the median of its neighbours; zero if its motion is
    /// implausible.
    recall: f64,
}

saved! { struct DeferredImage { num_points, recall } }

impl NextBestView {
    pub(crate) fn new(
        graph: &CorrespondenceGraph,
        scene: &Reconstruction,
        frames: KnownFrames,
        seed: u64,
    ) -> Self {
        Self {
            seed,
            timelines: Timelines::new(graph, scene),
            frames,
            trials: BTreeMap::new(),
            registrations: BTreeMap::new(),
            recalls: BTreeMap::new(),
            deferred: BTreeMap::new(),
        }
    }

    /// A copy of what is remembered.
    pub(crate) fn history(&self) -> History {
        let Self { trials, registrations, recalls, deferred, .. } = self;
        let (trials, registrations) = (trials.clone(), registrations.clone());
        History { trials, registrations, recalls: recalls.clone(), deferred: deferred.clone() }
    }

    /// Goes on from what an earlier run remembered.
    pub(crate) fn restore(&mut self, history: History) {
        let History { trials, registrations, recalls, deferred } = history;
        (self.trials, self.registrations) = (trials, registrations);
        (self.recalls, self.deferred) = (recalls, deferred);
    }

    /// Failed images may be tried again.
    pub(crate) fn reset_trials(&mut self) {
        self.trials.clear();
    }

    /// Measures the recalls of registered images, of which none was registered here.
    pub(crate) fn learn_recalls(
        &mut self,
        graph: &CorrespondenceGraph,
        model: &Reconstruction,
        options: &RegisterOptions,
    ) {
        for (image, ..) in model.registered() {
            let recall = Recall::of_registered(graph, model, image).share(options);
            self.recalls.insert(self.frames.first_of(model, image), recall);
        }
    }

    /// A part of a drive that is out of reach of the parts before and after it. Images that were
    /// registered twice are in none: their matches brought them back.
    pub(crate) fn part_out_of_reach(&self, model: &Reconstruction) -> Option<Vec<ImageId>> {
        let is_new = |image| self.registrations.get(&image).is_none_or(|times| *times < 2);
        self.timelines.part_out_of_reach(model, &is_new)
    }

    /// The frames that are registered as a whole.
    pub(crate) fn frames(&self) -> &KnownFrames {
        &self.frames
    }

    /// Registers the next of `images`, with its frame; `None` if none can be registered. A frame is
    /// among them by its first image, which is returned. With [`Evidence::Significant`], images
    /// that would be deferred are not registered.
    pub(crate) fn register_next(
        &mut self,
        graph: &CorrespondenceGraph,
        model: &mut Reconstruction,
        images: Vec<ImageId>,
        options: &RegisterOptions,
        evidence: Evidence,
    ) -> Option<ImageId> {
        let may_try = |image: &ImageId| {
            let attempts = [&self.trials, &self.registrations].map(|times| times.get(image));
            attempts.into_iter().flatten().all(|times| *times < MAX_TRIALS)
        };
        let mut candidates: Vec<(Visibility, ImageId)> = images
            .into_par_iter()
            .filter(may_try)
            .map(|image| (self.visibility(graph, model, image), image))
            .filter(|(seen, _)| seen.num_points >= evidence.min_num_inliers(options))
            .collect();
        candidates.sort_by_key(|(seen, image)| (std::cmp::Reverse(seen.score), *image));
        loop {
            let placement = match self.choose(graph, model, &candidates, options, evidence) {
                Ok(placement) => placement,
                Err(failed) => {
                    candidates.retain(|(_, image)| !failed.contains(image));
                    if failed.is_empty() || candidates.is_empty() {
                        return None;
                    }
                    continue;
                }
            };
            placement.apply(model);
            let image = placement.image();
            *self.registrations.entry(image).or_insert(0) += 1;
            self.recalls.insert(image, placement.recall);
            self.deferred.remove(&image);
            return Some(image);
        }
    }

    /// The visibility of an image, or the sum over its frame.
    fn visibility(
        &self,
        graph: &CorrespondenceGraph,
        model: &Reconstruction,
        image: ImageId,
    ) -> Visibility {
        let images = self.frames.registered_with(model, image).into_iter();
        images.map(|image| visibility(graph, model, image)).fold(Visibility::default(), |a, b| {
            Visibility { num_points: a.num_points + b.num_points, score: a.score + b.score }
        })
    }

    /// Returns the placement of the first candidate that is not deferred. If there is none: an
    /// error with the candidates that have no pose, or else the best deferred candidate. One that
    /// both its motion and its recall contradict is not registered.
    fn choose(
        &mut self,
        graph: &CorrespondenceGraph,
        model: &Reconstruction,
        candidates: &[(Visibility, ImageId)],
        options: &RegisterOptions,
        evidence: Evidence,
    ) -> Result<Placement, BTreeSet<ImageId>> {
        let unregistered: BTreeSet<ImageId> = candidates.iter().map(|(_, image)| *image).collect();
        let mut failed = BTreeSet::new();
        let mut deferred_candidates: Vec<(f64, ImageId)> = Vec::new();
        for &(Visibility { num_points, .. }, image) in candidates {
            if self.timelines.must_wait(model, image, &unregistered, evidence) {
                continue;
            }
            // With hardly more visible points the pose would hardly change.
            let is_known = |deferred: &&DeferredImage| {
                (num_points as f64) < MIN_GROWTH * deferred.num_points as f64
            };
            let recall = match self.deferred.get(&image).filter(is_known) {
                Some(known) => known.recall,
                None => {
                    let Some(placement) =
                        self.estimate_pose(graph, model, image, options, evidence)
                    else {
                        failed.insert(image);
                        continue;
                    };
                    let expected = self.neighbours_recall(graph, model, image, evidence);
                    let recall = placement.recall.unwrap_or(1.0);
                    if placement.is_plausible && recall >= MIN_RELATIVE_RECALL * expected {
                        return Ok(placement);
                    }
                    let recall = if placement.is_plausible { recall / expected } else { 0.0 };
                    self.deferred.insert(image, DeferredImage { num_points, recall });
                    recall
                }
            };
            deferred_candidates.push((recall, image));
        }
        // Other candidates may have waited only for the failed ones. They come before deferred
        // images.
        if !failed.is_empty() || evidence == Evidence::Significant {
            return Err(failed);
        }
        deferred_candidates.sort_by(|(a, one), (b, other)| b.total_cmp(a).then(one.cmp(other)));
        for (_, image) in deferred_candidates {
            let Some(placement) = self.estimate_pose(graph, model, image, options, evidence) else {
                failed.insert(image);
                continue;
            };
            let expected = self.neighbours_recall(graph, model, image, evidence);
            let has_recall = placement.recall.unwrap_or(1.0) >= MIN_RELATIVE_RECALL * expected;
            if placement.is_plausible || has_recall {
                return Ok(placement);
            }
            // Images behind it in time go on waiting: registered past it, they would be misplaced
            // by the same windows.
        }
        Err(failed)
    }

    /// Estimates the pose of an image, or of its frame. A failure counts as a trial.
    fn estimate_pose(
        &mut self,
        graph: &CorrespondenceGraph,
        model: &Reconstruction,
        image: ImageId,
        options: &RegisterOptions,
        evidence: Evidence,
    ) -> Option<Placement> {
        let key = [u64::from(image.0), model.num_registered() as u64];
        let seed = Rng::stream(self.seed, &key).next_u64();
        let motion = self.timelines.expected_motion(model, image);
        let view = self
            .frames
            .frame_of(model, image)
            .map_or(RegistrationUnit::Image(image), RegistrationUnit::Frame);
        let placement = estimate_placement(graph, model, &view, options, evidence, seed, motion);
        if placement.is_none() {
            *self.trials.entry(image).or_insert(0) += 1;
        }
        placement
    }

    /// Median visible-point recall of the registered neighbours of an image; zero without any. In
    /// doubt an image waits: an unknown recall of a neighbour counts as a full one, unless images
    /// that wait are not registered at all.
    fn neighbours_recall(
        &self,
        graph: &CorrespondenceGraph,
        model: &Reconstruction,
        image: ImageId,
        evidence: Evidence,
    ) -> f64 {
        let images = self.frames.registered_with(model, image);
        let neighbours = images.iter().flat_map(|image| graph.neighbours(*image));
        let neighbours = neighbours.filter(|other| model.image(**other).cam_from_world().is_some());
        let unknown = (evidence == Evidence::Usual).then_some(1.0);
        let of_frame = |other: &ImageId| {
            let recall = self.recalls.get(&self.frames.first_of(model, *other))?;
            recall.or(unknown)
        };
        let mut recalls: Vec<f64> = neighbours.filter_map(of_frame).collect();
        median(&mut recalls).unwrap_or(0.0)
    }
}
