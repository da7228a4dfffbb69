//! Stages that follow the growth of a model, in a list.

use tiepoint_scene::ImagePair;

use super::growth::Mapper;
use super::refinement_schedule::RefinementSchedule;
use super::solution::Solution;
use crate::Error;
use crate::event::{Event, Failure, OptionalStage, Watch, notify};
use crate::mapped_model::MappedModel;
use crate::options::RigMode;
use crate::rigs::{Context, Descriptors, constrain_rig, final_links};
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
    /// Closes loops.
    Loops,
    /// Moves an extended model back into its frame.
    Gauge,
    /// Constrains the cameras of a rig.
    Rig,
}

/// The first rolling-shutter stage comes before loop closure: a rolling shutter changes the scale
/// along a drive, sevenfold in 2 km, and no loop closes over such a change.
const STAGES: [Stage; 7] = [
    Stage::Refine(RefinementSchedule::BEFORE_LOOP_CLOSURE),
    Stage::RollingShutter { is_last: false },
    Stage::Loops,
    Stage::Refine(RefinementSchedule::FINAL),
    Stage::RollingShutter { is_last: true },
    Stage::Gauge,
    Stage::Rig,
];

impl Stage {
    /// Whether the stage sets poses other than by an adjustment of single images.
    fn moves_poses(self) -> bool {
        !matches!(self, Self::Refine(_))
    }

    /// The optional stage, which is undone if it fails; `None` for a stage that must succeed.
    fn optional(self) -> Option<OptionalStage> {
        match self {
            Self::RollingShutter { .. } => Some(OptionalStage::RollingShutter),
            Self::Rig => Some(OptionalStage::Rig),
            Self::Refine(_) | Self::Loops | Self::Gauge => None,
        }
    }
}

impl Mapper<'_> {
    /// Maps one connected component.
    pub(super) fn run(
        mut self,
        descriptors: &mut Descriptors,
        watch: &mut Watch,
    ) -> Result<MappedModel, Error> {
        let candidates = self.candidates();
        let initial_pair = match self.best_initial_pair(&candidates) {
            Some(pair) => self.initialise(&[pair], watch)?,
            None => self.initialise(&candidates, watch)?,
        };
        self.grow(watch)?;
        self.run_stages(Some(initial_pair), descriptors, watch)
    }

    /// Runs the stages that follow growth. Of a model with constant poses only the refinements run,
    /// because the others move poses.
    pub(super) fn run_stages(
        mut self,
        initial_pair: Option<ImagePair>,
        descriptors: &mut Descriptors,
        watch: &mut Watch,
    ) -> Result<MappedModel, Error> {
        self.solution.shutters =
            self.options.readout.map(|readout| RollingShutters::new(&self.solution.model, readout));
        let mut failures = Vec::new();
        let constant_poses = self.constant_poses.is_some();
        let stages = STAGES.into_iter().filter(|stage| !constant_poses || !stage.moves_poses());
        for stage in stages {
            let Some(optional) = stage.optional() else {
                self.run_stage(stage, descriptors, watch)?;
                continue;
            };
            if let Err(error) =
                self.transaction(|mapper| mapper.run_stage(stage, descriptors, watch))?
            {
                let failure = Failure { stage: optional, why: error.to_string() };
                notify(watch, &Event::Failed(failure.clone()))?;
                failures.push(failure);
                if matches!(stage, Stage::RollingShutter { is_last: false }) {
                    self.solution.shutters = None;
                }
            }
        }
        let Solution { model, shutters, num_loop_pairs, rig, .. } = self.solution;
        let is_used = |camera| model.registered().any(|(_, image, _)| image.camera == camera);
        let mut shutters = shutters.map_or(Vec::new(), |shutters| shutters.get().to_vec());
        shutters.retain(|shutter| is_used(shutter.camera));
        let row_poses = row_poses(&model, &shutters);
        Ok(MappedModel {
            reconstruction: model,
            initial_pair,
            rig,
            shutters,
            row_poses,
            num_loop_pairs,
            failures,
        })
    }

    fn run_stage(
        &mut self,
        stage: Stage,
        descriptors: &mut Descriptors,
        watch: &mut Watch,
    ) -> Result<(), Error> {
        match stage {
            Stage::Refine(schedule) => {
                self.estimate_noise();
                self.refine_globally(&schedule, watch)
            }
            Stage::RollingShutter { is_last } => self.rectify_shutters(is_last, watch),
            Stage::Loops => self.close_loops(watch),
            Stage::Gauge => {
                self.restore_gauge();
                Ok(())
            }
            Stage::Rig => match self.options.rig {
                _ if self.known_rigs.is_some() => self.finish_known_rigs(),
                RigMode::Off => Ok(()),
                RigMode::Paper => {
                    let links = final_links(&self.solution.model, self.rig_pairs);
                    self.adjust_globally(&links, &RefinementSchedule::FINAL, watch).map(|_| ())
                }
                RigMode::Soft | RigMode::Rigid | RigMode::Auto => self.constrain_rig(descriptors),
            },
        }
    }

    /// Estimates the rig of the finished model and constrains its cameras.
    pub(super) fn constrain_rig(&mut self, descriptors: &mut Descriptors) -> Result<(), Error> {
        let context = Context {
            graph: self.graph,
            tracks: &self.options.tracks,
            filter: &self.options.filter,
            adjust: self.adjust_options(&RefinementSchedule::RIG),
            seed: self.options.seed,
        };
        self.solution.rig =
            constrain_rig(&context, &mut self.solution.model, self.options.rig, descriptors)?;
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
        let (options, before) =
            (self.adjust_options(schedule), self.solution.model.num_registered());
        shutters.estimate(&mut self.solution.model, &options)?;
        if is_last {
            shutters.estimate_standard_deviations(&self.solution.model, &options)?;
        }
        for round in 0..rounds {
            if round > 0 {
                shutters.rectify(&mut self.solution.model);
            }
            self.estimate_noise();
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
