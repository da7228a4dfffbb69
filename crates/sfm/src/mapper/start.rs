//! Selection of the initial pair.

use std::ops::ControlFlow;

use tiepoint_adjust::{RefineIntrinsics, Scope};
use tiepoint_geometry::Rigid3;
use tiepoint_scene::{ImageId, ImagePair, Reconstruction};

use super::growth::Growth;
use super::input::Input;
use super::refinement_schedule::RefinementSchedule;
use super::solution::Solution;
use crate::Error;
use crate::event::{Event, Watch, notify};
use crate::options::MapperOptions;
use crate::tracks::filter_all_points;
use crate::two_view::{InitialPair, estimate_relative_pose, initial_pairs};

/// Maximum number of initial pairs that are tried.
const MAX_INITIAL_PAIRS: usize = 20;
/// Maximum number of candidate pairs.
const MAX_CANDIDATES: usize = 400;
/// Images of a trial model, and the number of trial models.
const MAX_TRIAL_IMAGES: usize = 7;
const MAX_TRIAL_MODELS: usize = 6;
/// A trial model with this relative support is accepted at once. Its rms error is below 0.5 px.
const ACCEPTED_SUPPORT: f64 = 0.94;

/// Errors from this size on do not support a hypothesis, in pixels.
const MAX_SUPPORT_ERROR_PX: f64 = 2.0;

impl Growth<'_> {
    /// Returns the candidate pairs, best first.
    pub(super) fn candidates(&self) -> Vec<InitialPair> {
        let mapped = &self.mapped_images;
        let is_free = |pair: ImagePair| !mapped.contains(&pair.a) && !mapped.contains(&pair.b);
        let Input { graph, options, .. } = self.refiner.input;
        let max_error_px = options.filter.max_error_px;
        initial_pairs(graph, self.model(), &is_free, max_error_px, MAX_CANDIDATES)
    }

    /// Returns the candidate whose trial model has the largest support. Repeated texture gives
    /// pairs that are consistent with wrong depths; only further images reveal them. Candidates
    /// near to a tried pair are skipped.
    pub(super) fn best_initial_pair(&self, candidates: &[InitialPair]) -> Option<InitialPair> {
        let Input { graph, scene, options, .. } = self.refiner.input;
        let options = &MapperOptions { refine: RefineIntrinsics::NONE, ..*options };
        let input = Input::of_trial(graph, scene, options);
        let mut tried: Vec<ImageId> = Vec::new();
        let mut best: Option<(f64, InitialPair)> = None;
        for candidate in candidates {
            let images = [candidate.pair.a, candidate.pair.b];
            let is_near = |a: ImageId, b: ImageId| a == b || graph.neighbours(a).contains(&b);
            if tried.iter().any(|&other| images.iter().any(|&image| is_near(image, other))) {
                continue;
            }
            let mut trial = Growth::trial(input, self.mapped_images.clone(), MAX_TRIAL_IMAGES);
            if trial.initialise(&[*candidate], &mut |_| ControlFlow::Continue(())).is_err() {
                continue;
            }
            // A failed trial counts with the images that it registered.
            let _ = trial.grow(&mut |_| ControlFlow::Continue(()));
            tried.extend(images);
            let (score, relative_support) = support(trial.model());
            if best.as_ref().is_none_or(|(most, _)| score > *most) {
                best = Some((score, *candidate));
            }
            if relative_support > ACCEPTED_SUPPORT || tried.len() == 2 * MAX_TRIAL_MODELS {
                break;
            }
        }
        best.map(|(_, candidate)| candidate)
    }

    /// Initialises the model with the first candidate that gives enough points.
    pub(super) fn initialise(
        &mut self,
        candidates: &[InitialPair],
        watch: &mut Watch,
    ) -> Result<ImagePair, Error> {
        let Input { graph, options, .. } = self.refiner.input;
        let start = self.model().clone();
        let mut most = 0;
        for candidate in candidates.iter().take(MAX_INITIAL_PAIRS) {
            let pair = candidate.pair;
            let seed = self.refiner.input.seed_of(&[u64::from(pair.a.0), u64::from(pair.b.0)]);
            let Some(cam2_from_cam1) = estimate_relative_pose(graph, &start, pair, seed) else {
                continue;
            };
            let solution = &mut self.refiner.solution;
            *solution = Solution { initial_pair: Some(pair), ..Solution::new(start.clone()) };
            solution.model.register(pair.a, Rigid3::identity());
            solution.model.register(pair.b, cam2_from_cam1);
            self.triangulate(pair.a);
            let adjusted = self.refiner.adjust(&Scope::Global, &RefinementSchedule::INITIAL);
            filter_all_points(&mut self.refiner.solution.model, &options.filter);
            let num_points = self.model().num_tracks();
            most = most.max(num_points);
            if adjusted.is_ok() && num_points >= options.min_initial_inliers {
                notify(watch, &Event::Initialised { image1: pair.a, image2: pair.b, num_points })?;
                return Ok(pair);
            }
        }
        self.refiner.solution = Solution::new(start);
        Err(Error::NoInitialPair {
            verified: graph.pairs().len(),
            best_inliers: most,
            required: options.min_initial_inliers,
        })
    }
}

/// Support of a model: the sum over observations of 1 − (error / threshold)², at least 0. Also
/// returns the sum relative to the number of observations.
pub(super) fn support(model: &Reconstruction) -> (f64, f64) {
    let errors = model
        .tracks()
        .flat_map(|(_, t)| t.observations.iter().map(|o| model.observation_error_px(o, &t.xyz)));
    let sum: f64 = errors
        .flatten()
        .map(|error_px| (1.0 - (error_px / MAX_SUPPORT_ERROR_PX).powi(2)).max(0.0))
        .sum();
    (sum, sum / model.num_observations().max(1) as f64)
}
