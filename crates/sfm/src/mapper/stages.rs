//! What is made of a model once no further image can be registered: a list of stages, each of which
//! the next one builds on.

use super::growth::Mapper;
use super::refinement_schedule::RefinementSchedule;
use super::solution::Solution;
use crate::Error;
use crate::event::{Event, Failure, OptionalStage, Watch, tell};
use crate::mapped_model::MappedModel;
use crate::options::RigTerm;
use crate::rigs::{Context, Descriptors, constrain_rig, final_links};
use crate::rolling_shutter::{RollingShutters, row_poses};

/// How often keypoints are straightened by the model in the end, and the model made by them.
const STRAIGHT_ROUNDS: usize = 3;
/// A wrong readout time removes most observations, because the shifted keypoints no longer fit any
/// pose: at least this share of the images must keep theirs.
const MIN_STRAIGHTENED: f64 = 0.5;

/// A stage.
#[derive(Clone, Copy)]
enum Stage {
    /// Everything is refined, keypoints weighing by the noise that they have now.
    Refine(RefinementSchedule),
    /// What rolling shutters did is taken off the keypoints.
    RollingShutter { is_last: bool },
    /// Loops are closed.
    Loops,
    /// Cameras are held to each other.
    Rig,
}

/// Shutters come before loops, too: a rolling shutter makes a drive grow or shrink on its way,
/// sevenfold in 2 km, and no loop closes over that.
const STAGES: [Stage; 6] = [
    Stage::Refine(RefinementSchedule::GROWN),
    Stage::RollingShutter { is_last: false },
    Stage::Loops,
    Stage::Refine(RefinementSchedule::FINAL),
    Stage::RollingShutter { is_last: true },
    Stage::Rig,
];

impl Stage {
    /// Whether a model is finished without it, too: where it fails, it is undone.
    fn optional(self) -> Option<OptionalStage> {
        match self {
            Self::RollingShutter { .. } => Some(OptionalStage::RollingShutter),
            Self::Rig => Some(OptionalStage::Rig),
            Self::Refine(_) | Self::Loops => None,
        }
    }
}

impl Mapper<'_> {
    /// Maps what hangs together.
    pub(super) fn run(
        mut self,
        descriptors: &mut Descriptors,
        watch: &mut Watch,
    ) -> Result<MappedModel, Error> {
        let candidates = self.candidates();
        let initial_pair = match self.best_start(&candidates) {
            Some(pair) => self.initialise(&[pair], watch)?,
            None => self.initialise(&candidates, watch)?,
        };
        self.grow(watch)?;
        self.solution.shutters =
            self.options.readout.map(|readout| RollingShutters::new(&self.solution.model, readout));
        let mut failures = Vec::new();
        for stage in STAGES {
            let Some(optional) = stage.optional() else {
                self.work(stage, descriptors, watch)?;
                continue;
            };
            if let Err(error) = self.transaction(|mapper| mapper.work(stage, descriptors, watch))? {
                let failure = Failure { stage: optional, why: error.to_string() };
                tell(watch, &Event::Failed(failure.clone()))?;
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

    fn work(
        &mut self,
        stage: Stage,
        descriptors: &mut Descriptors,
        watch: &mut Watch,
    ) -> Result<(), Error> {
        match stage {
            Stage::Refine(schedule) => {
                self.weigh();
                self.refine_globally(&schedule, watch)
            }
            Stage::RollingShutter { is_last } => self.rectify_shutters(is_last, watch),
            Stage::Loops => self.close_loops(watch),
            Stage::Rig => match self.options.rig {
                RigTerm::Off => Ok(()),
                RigTerm::Paper => {
                    let links = final_links(&self.solution.model, self.rigs);
                    self.adjust_globally(&links, &RefinementSchedule::FINAL, watch).map(|_| ())
                }
                RigTerm::Soft | RigTerm::Hard | RigTerm::Auto => self.constraint(descriptors),
            },
        }
    }

    /// Holds the cameras of the finished model to their mountings.
    pub(super) fn constraint(&mut self, descriptors: &mut Descriptors) -> Result<(), Error> {
        let context = Context {
            graph: self.graph,
            tracks: &self.options.tracks,
            filter: &self.options.filter,
            adjust: self.adjust_options(&RefinementSchedule::HOLDING),
            seed: self.options.seed,
        };
        self.solution.rig =
            constrain_rig(&context, &mut self.solution.model, self.options.rig, descriptors)?;
        Ok(())
    }

    /// Takes off the keypoints what rolling shutters did to them, and refines the model with what
    /// is left.
    fn rectify_shutters(&mut self, is_last: bool, watch: &mut Watch) -> Result<(), Error> {
        let Some(mut shutters) = self.solution.shutters.take() else { return Ok(()) };
        let (schedule, rounds) = if is_last {
            (&RefinementSchedule::STRAIGHTENED, STRAIGHT_ROUNDS)
        } else {
            (&RefinementSchedule::GROWN, 1)
        };
        let (options, before) =
            (self.adjust_options(schedule), self.solution.model.num_registered());
        shutters.find(&mut self.solution.model, &options)?;
        if is_last {
            shutters.find_deviations(&self.solution.model, &options)?;
        }
        for round in 0..rounds {
            if round > 0 {
                shutters.rectify(&mut self.solution.model);
            }
            self.weigh();
            self.refine_globally(schedule, watch)?;
        }
        let after = self.solution.model.num_registered();
        if (after as f64) < MIN_STRAIGHTENED * before as f64 {
            return Err(Error::ImagesLost { before, after });
        }
        self.solution.shutters = Some(shutters);
        Ok(())
    }
}
