//! Bundle adjustment of a model under construction, with its tracks and filters.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_adjust::{
    AdjustOptions, Gauge, RefineIntrinsics, Scope, Term, adjust, keep_going, relative_noise,
};
use tiepoint_ba::Summary;
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use super::existing::Existing;
use super::input::Input;
use super::refinement_schedule::RefinementSchedule;
use super::solution::{Phase, Solution};
use super::term_frame::{active, term_from_model, without_scaling};
use crate::Error;
use crate::event::{Event, Watch, notify};
use crate::mapped_model::OtherPlace;
use crate::options::RigMode;
use crate::register::duplicate_place;
use crate::rigs::{BaselineTerm, LinkWeights};
use crate::terms::with_terms;
use crate::timeline::{images_in_time, images_of_cameras};
use crate::tracks::{
    TOLERANCE_BEFORE_TRACK_UPDATE, complete_tracks, filter_all_points, filter_images,
    filter_points, merge_tracks, update_tracks,
};

/// The next round is the last if the number of observations and the cost change by less than this
/// fraction.
const MIN_CHANGE: f64 = TOLERANCE_BEFORE_TRACK_UPDATE;
/// Minimum number of images for refining the distortion.
const MIN_IMAGES_FOR_DISTORTION: usize = 5;
/// Minimum rotation of a camera (20°) for refining focal length and principal point. From pure
/// translation these are ambiguous: the points can be sheared and stretched to fit other values.
const MIN_ROTATION_RAD: f64 = 0.35;

/// Adjusts the model of a solution, while it grows and after.
pub(super) struct Refiner<'a> {
    pub(super) input: Input<'a>,
    /// The model that this one goes on from.
    pub(super) existing: Option<&'a Existing>,
    /// The paper's rig term; without pairs it adds nothing.
    pub(super) baselines: BaselineTerm<'a>,
    /// Terms of the caller.
    pub(super) terms: Vec<&'a mut dyn Term>,
    pub(super) solution: Solution,
}

impl<'a> Refiner<'a> {
    pub(super) fn new(
        input: Input<'a>,
        model: Reconstruction,
        terms: Vec<&'a mut dyn Term>,
    ) -> Self {
        let baselines = BaselineTerm { rigs: input.rig_pairs, weights: LinkWeights::Growing };
        Self { input, existing: None, baselines, terms, solution: Solution::new(model) }
    }

    /// All images are registered: estimates the noise scale of the keypoints, which later
    /// adjustments use.
    pub(super) fn complete(&mut self) {
        self.solution.phase = Phase::Complete { noise: relative_noise(&self.solution.model) };
    }

    /// Moves the model into the frame of the terms as soon as they know it. Constant poses stay,
    /// and rigs with constant extrinsics keep the scale.
    pub(super) fn move_to_frame_of_terms(&mut self) {
        let model = &self.solution.model;
        let Some(mut similarity) = term_from_model(&self.terms, model) else { return };
        if self.has_constant_rigs() && !model.frames.is_empty() {
            similarity = without_scaling(&similarity, model);
        }
        if self.constant_poses().is_none() {
            self.solution.model.transform(&similarity);
        }
        self.solution.is_in_frame_of_terms = true;
    }

    /// Runs bundle adjustment with the terms; of all images in the frame of the terms.
    pub(super) fn adjust(
        &mut self,
        scope: &Scope,
        schedule: &RefinementSchedule,
    ) -> Result<Summary, tiepoint_adjust::Error> {
        if matches!(scope, Scope::Global) {
            self.move_to_frame_of_terms();
        }
        self.solution.intrinsics_sds = None;
        let options = self.adjust_options(schedule);
        let terms = &mut active(&mut self.terms, &self.solution);
        let terms = &mut with_terms(&mut self.baselines, terms);
        adjust(&mut self.solution.model, scope, &options, terms, &mut keep_going)
    }

    /// Adjusts some images, completes and merges the tracks of their points and filters them.
    pub(super) fn adjust_locally(&mut self, images: &BTreeSet<ImageId>) -> Result<(), Error> {
        match self.adjust(&Scope::Local(images), &RefinementSchedule::LOCAL) {
            Ok(_) | Err(tiepoint_adjust::Error::NothingToAdjust { .. }) => {}
            Err(error) => return Err(error.into()),
        }
        let Input { graph, options, .. } = self.input;
        let model = &mut self.solution.model;
        let points = model.points_observed_by(images);
        complete_tracks(graph, model, &points, &options.tracks);
        merge_tracks(graph, model, &points, &options.tracks);
        let points = model.points_observed_by(images);
        filter_points(model, &points, &options.filter);
        Ok(())
    }

    /// Updates the tracks, adjusts and filters until the changes are small. Only the last
    /// adjustment converges fully.
    pub(super) fn refine_globally(
        &mut self,
        schedule: &RefinementSchedule,
        watch: &mut Watch,
    ) -> Result<(), Error> {
        let mut before = (self.solution.model.num_observations(), f64::INFINITY);
        let mut is_settled = false;
        for round in 1..=schedule.rounds {
            let Input { graph, options, .. } = self.input;
            update_tracks(graph, &mut self.solution.model, &options.tracks);
            if is_settled || round == schedule.rounds {
                self.adjust_globally(schedule, watch)?;
                break;
            }
            let after = self.adjust_globally(&schedule.before_track_update(), watch)?;
            let changed = |now: f64, then: f64| (now - then).abs() >= MIN_CHANGE * now.abs();
            is_settled = !changed(after.0 as f64, before.0 as f64) && !changed(after.1, before.1);
            before = after;
        }
        Ok(())
    }

    /// Runs global bundle adjustment and filters. Returns the number of observations and the cost.
    pub(super) fn adjust_globally(
        &mut self,
        schedule: &RefinementSchedule,
        watch: &mut Watch,
    ) -> Result<(usize, f64), Error> {
        let summary = self.adjust(&Scope::Global, schedule)?;
        let options = self.input.options;
        let constant = self.constant_poses();
        let model = &mut self.solution.model;
        filter_all_points(model, &options.filter);
        filter_images(model, options.register.min_num_inliers / 2, &|image| {
            constant.is_some_and(|images| images.contains(&image))
        });
        let (num_observations, cost) = (model.num_observations(), summary.final_cost);
        let (num_images, iterations) = (model.num_registered(), summary.iterations.len());
        notify(watch, &Event::Adjusted { num_images, num_observations, cost, iterations })?;
        Ok((num_observations, cost))
    }

    /// Options of an adjustment: intrinsics are refined as far as the registered images determine
    /// them. Calibrated ones stay constant while the model grows. After that the calibration holds
    /// what the images do not determine.
    pub(super) fn adjust_options(&self, schedule: &RefinementSchedule) -> AdjustOptions<'a> {
        self.adjust_options_in(self.solution.phase, schedule)
    }

    /// [`Refiner::adjust_options`] as if the model were in this phase.
    pub(super) fn adjust_options_in(
        &self,
        phase: Phase,
        schedule: &RefinementSchedule,
    ) -> AdjustOptions<'a> {
        let Input { options, focal_priors, .. } = self.input;
        let Solution { ref model, initial_pair, is_in_frame_of_terms, .. } = self.solution;
        let mut refine = options.refine;
        let (is_complete, has_rotation) = (phase != Phase::Growing, has_rotation(model));
        refine.focal &= is_complete || has_rotation;
        refine.principal_point &= is_complete && has_rotation;
        if model.num_registered() < MIN_IMAGES_FOR_DISTORTION {
            refine = RefineIntrinsics {
                focal: refine.focal,
                aspect: refine.aspect,
                ..RefineIntrinsics::NONE
            };
        }
        let mut refine_calibrated =
            if is_complete { options.refine } else { RefineIntrinsics::NONE };
        if model.num_registered() < 3 {
            (refine, refine_calibrated) = (RefineIntrinsics::NONE, RefineIntrinsics::NONE);
        }
        let gauge = match initial_pair {
            _ if is_in_frame_of_terms => Gauge::FixedByTerms,
            Some(pair) if options.rig == RigMode::Paper => Gauge::Pair(pair),
            _ => Gauge::FirstAndFarthest,
        };
        let adjust = AdjustOptions {
            refine,
            refine_calibrated: Some(refine_calibrated),
            select_tracks: schedule.select_tracks,
            loss: options.loss,
            focal_priors,
            constant_poses: self.constant_poses(),
            gauge,
            constant_rigs: self.has_constant_rigs(),
            max_iterations: schedule.max_iterations,
            function_tolerance: schedule.tolerance,
            ..AdjustOptions::default()
        };
        match phase {
            Phase::Complete { noise } => adjust.with_noise(noise),
            Phase::Growing => adjust,
        }
    }

    /// What is not known of the intrinsics of cameras without a calibration: what an adjustment
    /// refines, and the principal points that it holds because no camera turns. Few images tell
    /// nothing of either.
    pub(super) fn unknown_intrinsics(&self, schedule: &RefinementSchedule) -> RefineIntrinsics {
        let refine = self.adjust_options(schedule).refine;
        let is_small = self.solution.model.num_registered() < MIN_IMAGES_FOR_DISTORTION;
        let principal_point = self.input.options.refine.principal_point && !is_small;
        RefineIntrinsics { principal_point, ..refine }
    }

    /// Images whose poses are constant, and which always stay registered.
    pub(super) fn constant_poses(&self) -> Option<&'a BTreeSet<ImageId>> {
        self.existing.and_then(Existing::constant_poses)
    }

    /// Runs `work` and restores the solution if it fails. The error of `work` is the inner one;
    /// [`Error::Cancelled`] is the outer one.
    pub(super) fn transaction<T>(
        &mut self,
        work: impl FnOnce(&mut Self) -> Result<T, Error>,
    ) -> Result<Result<T, Error>, Error> {
        let before = self.solution.clone();
        match work(self) {
            Err(Error::Cancelled) => Err(Error::Cancelled),
            Err(error) => {
                self.solution = before;
                Ok(Err(error))
            }
            Ok(done) => Ok(Ok(done)),
        }
    }

    /// Whether there are known rigs whose extrinsics are constant.
    pub(super) fn has_constant_rigs(&self) -> bool {
        self.input.known_rigs.is_some_and(|known| !known.refine_extrinsics)
    }

    /// The smaller of two places that the model holds as one. Not looked for in models of known
    /// rigs and of given poses, and where times of cameras are known: their continuity is better
    /// evidence.
    pub(super) fn other_place(&self) -> Option<OtherPlace> {
        let input = self.input;
        let is_timed = |images: &Vec<ImageId>| images_in_time(input.scene, images).is_some();
        if input.known_rigs.is_some()
            || self.existing.is_some()
            || images_of_cameras(input.scene).values().any(is_timed)
        {
            return None;
        }
        let options = input.options;
        duplicate_place(
            input.graph,
            &self.solution.model,
            options.min_model_size,
            options.register.max_error_px,
            options.seed,
        )
    }
}

/// Whether some image is rotated relative to the first image of its camera. Two cameras of a rig
/// have different orientations without rotating. If each image has its own camera, images are
/// compared with each other.
fn has_rotation(model: &Reconstruction) -> bool {
    let is_shared = model.cameras().count() < model.images().count();
    let mut first = BTreeMap::new();
    model.registered().any(|(_, image, pose)| {
        let camera = is_shared.then_some(image.camera);
        first.entry(camera).or_insert(pose.rotation).angle_to(&pose.rotation) > MIN_ROTATION_RAD
    })
}

/// Whether the images of a camera turn, which determines its focal length whatever those of others
/// do.
pub(super) fn turns(model: &Reconstruction, camera: CameraId) -> bool {
    let mut rotations = model
        .registered()
        .filter(|(_, image, _)| image.camera == camera)
        .map(|(_, _, pose)| pose.rotation);
    let Some(first) = rotations.next() else { return false };
    rotations.any(|rotation| first.angle_to(&rotation) > MIN_ROTATION_RAD)
}
