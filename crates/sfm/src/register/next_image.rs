//! Which image is registered next: the one that sees the most of the model, best spread, unless it
//! had better wait.
//!
//! Where texture repeats (windows of a facade), images that should see nothing of the model yet see
//! it by matches that are wrong and agree with each other, and drag all that follow along. The
//! right neighbours settle that, so they come first: images wait for those that are between them
//! and the model in time; and who finds less of what it ought to see than those around it did, or
//! jumps, waits for all others that do not wait for it.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use tiepoint_geometry::numeric::median;
use tiepoint_geometry::{Rigid3, Rng};
use tiepoint_scene::{CorrespondenceGraph, ImageId, Reconstruction};

use super::continuity::Timelines;
use super::place::{Placement, RegisterOptions, place_image};
use super::visibility::{Visibility, visibility};

/// An image that could not be registered is tried again at most this often; and one that was, and
/// was taken out again since.
const MAX_TRIALS: usize = 3;
/// An image that waits is placed again when it sees so many times as much of the model.
const MIN_GROWTH: f64 = 1.1;
/// An image waits when it finds less than this share of what it ought to see, relative to the
/// images around it. Where all is well that is 0.76 and more; where windows were taken for others,
/// 0.49 to 0.75.
const MIN_SHARE_OF_USUAL: f64 = 0.75;

/// What is known of images that were registered, and of those that were not.
pub(crate) struct NextBestView {
    seed: u64,
    timelines: Timelines,
    /// How often each image failed to register.
    trials: BTreeMap<ImageId, usize>,
    /// How often each image was registered: what is filtered out every time would be for ever.
    registrations: BTreeMap<ImageId, usize>,
    /// Of what each image ought to have seen when it was registered, how much it did.
    shares: BTreeMap<ImageId, f64>,
    /// Images that could have been registered, and had better wait.
    poor: BTreeMap<ImageId, DeferredImage>,
}

/// An image that waits for others.
#[derive(Clone, Copy, Debug)]
struct DeferredImage {
    /// What it saw of the model.
    num_points: usize,
    /// How much it found of what it ought to see, as a share of what is usual around it; nothing if
    /// it jumps.
    share: f64,
}

impl NextBestView {
    pub(crate) fn new(scene: &Reconstruction, seed: u64) -> Self {
        Self {
            seed,
            timelines: Timelines::new(scene),
            trials: BTreeMap::new(),
            registrations: BTreeMap::new(),
            shares: BTreeMap::new(),
            poor: BTreeMap::new(),
        }
    }

    /// Images that failed are tried again.
    pub(crate) fn reset_trials(&mut self) {
        self.trials.clear();
    }

    /// Registers the next one of some images; `None` when none can be.
    pub(crate) fn register_next(
        &mut self,
        graph: &CorrespondenceGraph,
        model: &mut Reconstruction,
        images: Vec<ImageId>,
        options: &RegisterOptions,
    ) -> Option<ImageId> {
        let may_try = |image: &ImageId| {
            let tried = [&self.trials, &self.registrations].map(|times| times.get(image));
            tried.into_iter().flatten().all(|times| *times < MAX_TRIALS)
        };
        let mut candidates: Vec<(Visibility, ImageId)> = images
            .into_par_iter()
            .filter(may_try)
            .map(|image| (visibility(graph, model, image), image))
            .filter(|(seen, _)| seen.num_points >= options.min_num_inliers)
            .collect();
        candidates.sort_by_key(|(seen, image)| (std::cmp::Reverse(seen.score), *image));
        loop {
            let placement = match self.choose(graph, model, &candidates, options) {
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
            *self.registrations.entry(placement.image).or_insert(0) += 1;
            self.shares.insert(placement.image, placement.share);
            self.poor.remove(&placement.image);
            return Some(placement.image);
        }
    }

    /// The first of the candidates; or those that have no pose, if any; or the best of those that
    /// had better wait.
    fn choose(
        &mut self,
        graph: &CorrespondenceGraph,
        model: &Reconstruction,
        candidates: &[(Visibility, ImageId)],
        options: &RegisterOptions,
    ) -> Result<Placement, BTreeSet<ImageId>> {
        let open: BTreeSet<ImageId> = candidates.iter().map(|(_, image)| *image).collect();
        let mut failed = BTreeSet::new();
        let mut waiting: Vec<(f64, ImageId)> = Vec::new();
        for &(Visibility { num_points, .. }, image) in candidates {
            if self.timelines.waits(model, image, &open) {
                continue;
            }
            // Who sees hardly more than it saw has hardly another pose.
            let is_known =
                |poor: &&DeferredImage| (num_points as f64) < MIN_GROWTH * poor.num_points as f64;
            let share = match self.poor.get(&image).filter(is_known) {
                Some(known) => known.share,
                None => {
                    let Some(placement) = self.place(graph, model, image, options) else {
                        failed.insert(image);
                        continue;
                    };
                    let usual = self.usual_share(graph, model, image);
                    if placement.is_plausible && placement.share >= MIN_SHARE_OF_USUAL * usual {
                        return Ok(placement);
                    }
                    let share = if placement.is_plausible { placement.share / usual } else { 0.0 };
                    self.poor.insert(image, DeferredImage { num_points, share });
                    share
                }
            };
            waiting.push((share, image));
        }
        // Others may have waited for these alone, and come before those that had better wait.
        if !failed.is_empty() {
            return Err(failed);
        }
        waiting.sort_by(|(a, one), (b, other)| b.total_cmp(a).then(one.cmp(other)));
        for (_, image) in waiting {
            match self.place(graph, model, image, options) {
                Some(placement) => return Ok(placement),
                None => failed.insert(image),
            };
        }
        Err(failed)
    }

    /// The pose of an image; that there is none counts as a trial.
    fn place(
        &mut self,
        graph: &CorrespondenceGraph,
        model: &Reconstruction,
        image: ImageId,
        options: &RegisterOptions,
    ) -> Option<Placement> {
        let key = [u64::from(image.0), model.num_registered() as u64];
        let seed = Rng::stream(self.seed, &key).next_u64();
        let speed = self.timelines.usual_speed(model, image);
        let is_plausible = |pose: &Rigid3| {
            speed.is_none_or(|speed| !self.timelines.jumps(model, image, pose, speed))
        };
        let placement = place_image(graph, model, image, options, seed, &is_plausible);
        if placement.is_none() {
            *self.trials.entry(image).or_insert(0) += 1;
        }
        placement
    }

    /// Of what images of the model with verified pairs with this one ought to have seen, how much
    /// they did: the median.
    fn usual_share(
        &self,
        graph: &CorrespondenceGraph,
        model: &Reconstruction,
        image: ImageId,
    ) -> f64 {
        let has_pose = |other: &&ImageId| model.image(**other).cam_from_world().is_some();
        let around = graph.neighbours(image).iter().filter(has_pose);
        let mut shares: Vec<f64> =
            around.filter_map(|other| self.shares.get(other)).copied().collect();
        median(&mut shares).unwrap_or(0.0)
    }
}
