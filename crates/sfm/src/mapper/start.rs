//! Where a model begins.

use std::ops::ControlFlow;

use tiepoint_geometry::Rigid3;
use tiepoint_scene::{ImageId, ImagePair};

use super::explained::explained;
use super::growth::Mapper;
use super::refinement_schedule::RefinementSchedule;
use crate::Error;
use crate::adjust::{RefineIntrinsics, Scope, adjust, keep_going};
use crate::event::{Event, Watch, tell};
use crate::options::MapperOptions;
use crate::tracks::{filter_all_points, triangulate_image};
use crate::two_view::{InitialPair, initial_pairs, refine};

/// How many initial pairs are tried before giving up.
const MAX_INITIAL_TRIALS: usize = 20;
/// Initial pairs considered.
const MAX_CANDIDATES: usize = 400;
/// Images mapped from an initial pair to see whether it is sound, and how many pairs are tried so.
const MAX_START_IMAGES: usize = 7;
const MAX_STARTS: usize = 6;
/// A start that explains this share is taken at once: its rms error is below 0.5 px.
const GOOD_START_SHARE: f64 = 0.94;

impl Mapper<'_> {
    /// Pairs to begin with, the best first.
    pub(super) fn candidates(&self) -> Vec<InitialPair> {
        let is_free =
            |pair: ImagePair| !self.taken.contains(&pair.a) && !self.taken.contains(&pair.b);
        let max_error_px = self.options.filter.max_error_px;
        initial_pairs(self.graph, &self.solution.model, &is_free, max_error_px, MAX_CANDIDATES)
    }

    /// Texture that repeats fools pairs: they agree on wrong depths, and only further images tell.
    /// So a few images are mapped from the best pair, and unless they fit well, from others
    /// elsewhere, and the pair that explains the most is taken.
    pub(super) fn best_start(&self, candidates: &[InitialPair]) -> Option<InitialPair> {
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
                max_images: Some(MAX_START_IMAGES),
                ..Mapper::new(self.graph, &self.solution.model, options)
            };
            if trial.initialise(&[*candidate], &mut |_| ControlFlow::Continue(())).is_err() {
                continue;
            }
            // What a failed trial has reached counts.
            let _ = trial.grow(&mut |_| ControlFlow::Continue(()));
            tried.extend(images);
            let (score, share) = explained(&trial.solution.model);
            if best.as_ref().is_none_or(|(most, _)| score > *most) {
                best = Some((score, *candidate));
            }
            if share > GOOD_START_SHARE || tried.len() == 2 * MAX_STARTS {
                break;
            }
        }
        best.map(|(_, candidate)| candidate)
    }

    /// Begins with the first of the pairs that gives enough points.
    pub(super) fn initialise(
        &mut self,
        candidates: &[InitialPair],
        watch: &mut Watch,
    ) -> Result<ImagePair, Error> {
        let start = self.solution.model.clone();
        let mut most = 0;
        for candidate in candidates.iter().take(MAX_INITIAL_TRIALS) {
            let pair = candidate.pair;
            let seed = self.seed_of(&[u64::from(pair.a.0), u64::from(pair.b.0)]);
            let Some(cam2_from_cam1) = refine(self.graph, &self.solution.model, pair, seed) else {
                continue;
            };
            self.solution.model.register(pair.a, Rigid3::identity());
            self.solution.model.register(pair.b, cam2_from_cam1);
            self.initial = Some(pair);
            triangulate_image(self.graph, &mut self.solution.model, pair.a, &self.options.tracks);
            let options = self.adjust_options(&RefinementSchedule::INITIAL);
            let adjusted = adjust(
                &mut self.solution.model,
                &Scope::Global,
                &options,
                &mut [],
                &mut keep_going,
            );
            filter_all_points(&mut self.solution.model, &self.options.filter);
            most = most.max(self.solution.model.num_tracks());
            if adjusted.is_ok()
                && self.solution.model.num_tracks() >= self.options.min_initial_inliers
            {
                let num_points = self.solution.model.num_tracks();
                tell(watch, &Event::Initialised { image1: pair.a, image2: pair.b, num_points })?;
                return Ok(pair);
            }
            self.solution.model = start.clone();
        }
        Err(Error::NoInitialPair {
            verified: self.graph.pairs().len(),
            best_inliers: most,
            required: self.options.min_initial_inliers,
        })
    }
}
