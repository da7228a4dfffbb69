//! Stages that follow the growth of a model, in a list.

use std::collections::BTreeMap;

use tiepoint_adjust::{AdjustOptions, RefineIntrinsics};

use super::checkpoint::Checkpoints;
use super::input::Input;
use super::intrinsics_sds::intrinsics_sds;
use super::refinement_schedule::RefinementSchedule;
use super::refiner::Refiner;
use super::solution::Solution;
use super::term_frame::active;
use crate::Error;
use crate::event::{Event, Failure, OptionalStage, Watch, notify};
use crate::mapped_model::MappedModel;
use crate::options::RigMode;
use crate::rigs::{Context, Descriptors, HeldIntrinsics, LinkWeights, constrain_rig};
use crate::rolling_shutter::{RollingShutters, row_poses};

/// Rounds of rolling-shutter correction and refinement in the last correction stage.
const RECTIFICATION_ROUNDS: usize = 3;
/// A wrong readout time removes most observations, because the shifted keypoints no longer fit any
/// pose. At least this fraction of the images must keep theirs.
const MIN_REMAINING_IMAGES: f64 = 0.5;

/// A stage.
#[derive(Clone, Copy)]
enum Stage {
    /// Re-estimates the noise scale and refines globally.
    Refine(RefinementSchedule),
    /// Corrects the keypoints for rolling shutters.
    RollingShutter { is_last: bool },
    /// Tests whether the images contradict the calibrations.
    Calibrations,
    /// Fits focal lengths that the images hardly determine.
    UncertainFocalLengths,
    /// Closes loops.
    Loops,
    /// Moves an extended model back into its frame.
    Gauge,
    /// Constrains the cameras of a rig.
    Rig,
}

/// Calibrations are tested and focal lengths fitted when loops are closed, because these determine
/// focal lengths.
///
/// The first rolling-shutter stage comes before loop closure: a rolling shutter changes the scale
/// along a drive, sevenfold in 2 km, and no loop closes over such a change.
const STAGES: [Stage; 9] = [
    Stage::Refine(RefinementSchedule::BEFORE_LOOP_CLOSURE),
    Stage::RollingShutter { is_last: false },
    Stage::Loops,
    Stage::Refine(RefinementSchedule::FINAL),
    Stage::RollingShutter { is_last: true },
    Stage::Calibrations,
    Stage::UncertainFocalLengths,
    Stage::Gauge,
    Stage::Rig,
];

impl Stage {
    /// Whether the stage sets poses other than by an adjustment of single images.
    fn moves_poses(self) -> bool {
        !matches!(self, Self::Refine(_) | Self::Calibrations)
    }

    /// The optional stage, which is undone if it fails; `None` for a stage that must succeed.
    fn optional(self) -> Option<OptionalStage> {
        match self {
            Self::RollingShutter { .. } => Some(OptionalStage::RollingShutter),
            Self::Rig => Some(OptionalStage::Rig),
            Self::Refine(_)
            | Self::Calibrations
            | Self::UncertainFocalLengths
            | Self::Loops
            | Self::Gauge => None,
        }
    }
}

impl Refiner<'_> {
    /// Runs the stages that follow growth. Of a model with constant poses only the refinements run,
    /// because the others move poses.
    pub(super) fn run_stages(
        mut self,
        descriptors: &mut Descriptors,
        watch: &mut Watch,
        checkpoints: &mut Checkpoints,
    ) -> Result<MappedModel, Error> {
        self.restore_calibration_priors();
        let readout = self.input.options.readout;
        self.solution.shutters =
            readout.map(|readout| RollingShutters::new(&self.solution.model, readout));
        self.run_stages_from(0, Vec::new(), descriptors, watch, checkpoints)
    }

    /// [`Refiner::run_stages`] from the stage of an index on; `failures` are those before it.
    pub(super) fn run_stages_from(
        mut self,
        first: usize,
        mut failures: Vec<Failure>,
        descriptors: &mut Descriptors,
        watch: &mut Watch,
        checkpoints: &mut Checkpoints,
    ) -> Result<MappedModel, Error> {
        let constant_poses = self.constant_poses().is_some();
        let stages = STAGES.into_iter().enumerate().skip(first);
        for (index, stage) in stages.filter(|(_, stage)| !constant_poses || !stage.moves_poses()) {
            checkpoints.stages(self.input.scene, &self.solution, index, &failures);
            let Some(optional) = stage.optional() else {
                self.run_stage(stage, descriptors, watch)?;
                continue;
            };
            if let Err(error) =
                self.transaction(|refiner| refiner.run_stage(stage, descriptors, watch))?
            {
                let failure = Failure { stage: optional, reason: error.to_string() };
                notify(watch, &Event::Failed(failure.clone()))?;
                failures.push(failure);
                if matches!(stage, Stage::RollingShutter { is_last: false }) {
                    self.solution.shutters = None;
                }
            }
        }
        Ok(self.finished(failures))
    }

    fn finished(mut self, failures: Vec<Failure>) -> MappedModel {
        let schedule = &RefinementSchedule::FINAL;
        let refine = self.unknown_intrinsics(schedule);
        let options = AdjustOptions { refine, ..self.adjust_options(schedule) };
        let mut intrinsics_sds = match self.solution.intrinsics_sds.take() {
            Some(known) => known,
            None if self.input.options.refine == RefineIntrinsics::NONE => BTreeMap::new(),
            None => {
                let terms = &mut active(&mut self.terms, &self.solution);
                intrinsics_sds(&self.solution.model, &options, terms)
            }
        };
        let Solution {
            mut model,
            initial_pair,
            is_in_frame_of_terms,
            shutters,
            num_loop_pairs,
            rig,
            calibration_evidence,
            kept_intrinsics,
            field_sds,
            other_places,
            ..
        } = self.solution;
        // Later adjustments may refine them.
        model.calibrated.retain(|camera| !kept_intrinsics.contains(camera));
        intrinsics_sds.extend(field_sds);
        let registered = model.registered_cameras();
        let mut shutters = shutters.map_or(Vec::new(), |shutters| shutters.get().to_vec());
        shutters.retain(|shutter| registered.contains(&shutter.camera));
        let row_poses = row_poses(&model, &shutters);
        MappedModel {
            reconstruction: model,
            initial_pair,
            is_in_frame_of_terms,
            rig,
            calibration_evidence,
            intrinsics_sds,
            shutters,
            row_poses,
            num_loop_pairs,
            other_places,
            failures,
        }
    }

    fn run_stage(
        &mut self,
        stage: Stage,
        descriptors: &mut Descriptors,
        watch: &mut Watch,
    ) -> Result<(), Error> {
        match stage {
            Stage::Refine(schedule) => {
                self.complete();
                self.refine_globally(&schedule, watch)
            }
            Stage::RollingShutter { is_last } => self.rectify_shutters(is_last, watch),
            Stage::Calibrations => self.test_calibrations(watch),
            Stage::UncertainFocalLengths => self.fit_uncertain_focal_lengths(watch),
            Stage::Loops => self.close_loops(watch),
            Stage::Gauge => {
                self.restore_gauge();
                Ok(())
            }
            Stage::Rig => match self.input.options.rig {
                _ if self.input.known_rigs.is_some() => self.finish_known_rigs(),
                RigMode::Off => Ok(()),
                RigMode::Paper => {
                    self.baselines.weights = LinkWeights::Final;
                    self.adjust_globally(&RefinementSchedule::FINAL, watch).map(|_| ())
                }
                RigMode::Soft | RigMode::Rigid | RigMode::Auto => self.constrain_rig(descriptors),
            },
        }
    }

    /// Moves the model such that the existing images are closest to their first poses, unless it is
    /// in the frame of terms.
    fn restore_gauge(&mut self) {
        let existing = self.existing.filter(|_| !self.solution.is_in_frame_of_terms);
        let model = &mut self.solution.model;
        if let Some(similarity) = existing.and_then(|it| it.existing_from_model(model)) {
            model.transform(&similarity);
        }
    }

    /// Estimates the rig of the finished model and constrains its cameras.
    pub(super) fn constrain_rig(&mut self, descriptors: &mut Descriptors) -> Result<(), Error> {
        self.move_to_frame_of_terms();
        self.solution.intrinsics_sds = None;
        let Input { graph, options, .. } = self.input;
        let context = &mut Context {
            graph,
            tracks: &options.tracks,
            filter: &options.filter,
            adjust: self.adjust_options(&RefinementSchedule::RIG),
            held: HeldIntrinsics {
                unknown: self.unknown_intrinsics(&RefinementSchedule::RIG),
                constant: &self.solution.kept_intrinsics.clone(),
            },
            terms: active(&mut self.terms, &self.solution),
            seed: options.seed,
        };
        self.solution.rig =
            constrain_rig(context, &mut self.solution.model, options.rig, descriptors)?;
        Ok(())
    }

    /// Estimates readout times, corrects the keypoints and refines the model.
    fn rectify_shutters(&mut self, is_last: bool, watch: &mut Watch) -> Result<(), Error> {
        let Some(mut shutters) = self.solution.shutters.take() else { return Ok(()) };
        let (schedule, rounds) = if is_last {
            (&RefinementSchedule::RECTIFIED, RECTIFICATION_ROUNDS)
        } else {
            (&RefinementSchedule::BEFORE_LOOP_CLOSURE, 1)
        };
        let before = self.solution.model.num_registered();
        // No update of the tracks follows the estimation.
        let tolerance = RefinementSchedule::FINAL.tolerance;
        let options = self.adjust_options(&RefinementSchedule { tolerance, ..*schedule });
        let terms = &mut active(&mut self.terms, &self.solution);
        shutters.estimate(&mut self.solution.model, &options, terms)?;
        if is_last {
            shutters.estimate_standard_deviations(&self.solution.model, &options, terms)?;
        }
        for round in 0..rounds {
            if round > 0 {
                shutters.rectify(&mut self.solution.model);
            }
            self.complete();
            self.refine_globally(schedule, watch)?;
        }
        let after = self.solution.model.num_registered();
        if (after as f64) < MIN_REMAINING_IMAGES * before as f64 {
            return Err(Error::ImagesLost { before, after });
        }
        self.solution.shutters = Some(shutters);
        Ok(())
    }
}
