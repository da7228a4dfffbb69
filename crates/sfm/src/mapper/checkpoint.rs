//! The state of a run, from which a later run goes on to the same result.
//!
//! The state is what the mapper has in memory, bit for bit, at one of three kinds of places: behind
//! the registration of an image with its adjustments, before a stage that follows growth, and
//! between two models. Nothing else of a run is remembered: random streams have no state, and the
//! lists of images by time follow from the scene.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_adjust::FocalPrior;
use tiepoint_geometry::Intrinsics;
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use super::input::Input;
use super::solution::{Phase, Solution};
use crate::event::{Failure, OptionalStage};
use crate::mapped_model::{MappedModel, OtherPlace};
use crate::register::{History, NextBestView};
use crate::rolling_shutter::row_poses;
use crate::saved::{Reader, Saved, Writer, saved, write_list};

/// Keeps the state of a run outside of the process ([`crate::Mapper::checkpoints`]).
pub trait CheckpointStore {
    /// The state that an earlier run kept last, if there is one. It must be of a run of the same
    /// program with the same graph, scene and options.
    fn last(&mut self) -> Option<Vec<u8>>;

    /// Told once, if there was a state: with the number of images that have a pose in it, or `None`
    /// if it is no state of this scene, and the run begins from the start.
    fn resumed(&mut self, num_registered: Option<usize>);

    /// Whether it is time to keep a state. If it is, the state follows.
    fn is_due(&mut self) -> bool;

    /// Keeps a state in place of the earlier one.
    fn keep(&mut self, state: &[u8]);
}

/// The store of a run, and what its states have in common until a further model is finished.
pub(super) struct Checkpoints<'a> {
    store: Option<&'a mut (dyn CheckpointStore + 'a)>,
    finished: Vec<u8>,
    /// What an earlier run was doing.
    pub(super) resumed: Option<Current>,
}

/// A state.
struct State {
    /// Initial intrinsics of the cameras, and priors on their focal lengths.
    intrinsics: Vec<Intrinsics>,
    focal_priors: Vec<FocalPrior>,
    finished: Finished,
    current: Option<Current>,
}

saved! { struct State { intrinsics, focal_priors, finished, current } }

/// What is finished.
#[derive(Default)]
pub(super) struct Finished {
    /// The models that are kept.
    pub(super) models: Vec<MappedModel>,
    /// Images of all models, also of those that are not kept.
    pub(super) mapped_images: BTreeSet<ImageId>,
    pub(super) step: Step,
}

saved! { struct Finished { models, mapped_images, step } }

/// What is done with models.
#[derive(Clone, Copy, Default)]
pub(super) enum Step {
    /// A further one grows.
    #[default]
    Grow,
    /// They are joined with the one at an index; the ones before it are not. `smaller`: the index
    /// of the one that was joined, whose images grow on.
    Join { larger: usize, smaller: Option<usize> },
    /// The one at an index is merged with the first by the motion of its cameras.
    Merge { index: usize },
}

saved! { enum Step { 0 = Grow, 1 = Join { larger, smaller }, 2 = Merge { index } } }

/// A model in work.
pub(super) enum Current {
    /// It grows. `at_global`: the numbers of images and points at the last global adjustment.
    Growing { solution: Box<Solution>, history: History, at_global: (usize, usize) },
    /// The stages from the index `next` on are to be run.
    Stages { solution: Box<Solution>, next: usize, failures: Vec<Failure> },
}

/// First bytes of the two.
const GROWING: u8 = 0;
const STAGES: u8 = 1;

saved! {
    enum Current {
        0 = Growing { solution, history, at_global },
        1 = Stages { solution, next, failures },
    }
}

impl<'a> Checkpoints<'a> {
    pub(super) fn new(store: Option<&'a mut (dyn CheckpointStore + 'a)>) -> Self {
        Self { store, finished: Vec::new(), resumed: None }
    }

    /// For trials, which are short.
    pub(super) fn none() -> Self {
        Self::new(None)
    }

    /// What an earlier run had finished, with the priors on focal lengths. The cameras of `scene`
    /// get the intrinsics that they had then.
    pub(super) fn resume(
        &mut self,
        scene: &mut Reconstruction,
    ) -> Option<(Vec<FocalPrior>, Finished)> {
        let store = self.store.as_mut()?;
        let state = store.last()?;
        let found = State::of(&state, scene);
        store.resumed(found.as_ref().map(State::num_registered));
        let State { intrinsics, focal_priors, finished, current } = found?;
        for (index, intrinsics) in intrinsics.into_iter().enumerate() {
            scene.camera_mut(CameraId::from_index(index)).intrinsics = intrinsics;
        }
        self.resumed = current;
        Some((focal_priors, finished))
    }

    /// Says what is finished before the work of a step.
    pub(super) fn begin(
        &mut self,
        input: Input,
        models: &[MappedModel],
        mapped_images: &BTreeSet<ImageId>,
        step: Step,
    ) {
        if self.store.is_none() {
            return;
        }
        let scene = input.scene;
        let mut to = Writer { bytes: Vec::new(), scene };
        let intrinsics: Vec<Intrinsics> =
            scene.cameras().map(|(_, camera)| camera.intrinsics).collect();
        intrinsics.write(&mut to);
        write_list(input.focal_priors, &mut to);
        write_list(models, &mut to);
        mapped_images.write(&mut to);
        step.write(&mut to);
        self.finished = to.bytes;
        // A joined model is no model yet.
        let is_joined = matches!(step, Step::Join { smaller: Some(_), .. });
        if self.resumed.is_none() && !is_joined {
            self.keep(scene, |to| false.write(to));
        }
    }

    /// The state between two registrations, if it is due.
    pub(super) fn growing(
        &mut self,
        scene: &Reconstruction,
        solution: &Solution,
        next_best_view: &NextBestView,
        at_global: (usize, usize),
    ) {
        self.keep(scene, |to| {
            true.write(to);
            GROWING.write(to);
            solution.write(to);
            next_best_view.history().write(to);
            at_global.write(to);
        });
    }

    /// The state before a stage, if it is due.
    pub(super) fn stages(
        &mut self,
        scene: &Reconstruction,
        solution: &Solution,
        next: usize,
        failures: &[Failure],
    ) {
        self.keep(scene, |to| {
            true.write(to);
            STAGES.write(to);
            solution.write(to);
            next.write(to);
            write_list(failures, to);
        });
    }

    fn keep(&mut self, scene: &Reconstruction, current: impl FnOnce(&mut Writer)) {
        let Some(store) = &mut self.store else { return };
        if !store.is_due() {
            return;
        }
        let mut to = Writer { bytes: self.finished.clone(), scene };
        current(&mut to);
        debug_assert!(is_read_as_written(&to.bytes, scene), "a state that cannot be read");
        store.keep(&to.bytes);
    }
}

fn is_read_as_written(state: &[u8], scene: &Reconstruction) -> bool {
    let mut to = Writer { bytes: Vec::new(), scene };
    let found = State::of(state, scene);
    found.is_some_and(|found| {
        found.write(&mut to);
        to.bytes == state
    })
}

impl State {
    /// `None` if the bytes are no state of a run with this scene.
    fn of(bytes: &[u8], scene: &Reconstruction) -> Option<Self> {
        let mut from = Reader { bytes, scene };
        let this = Self::read(&mut from)?;
        let mut scene = scene.clone();
        let cameras = (0..scene.num_cameras()).map(CameraId::from_index);
        for (id, intrinsics) in cameras.zip(&this.intrinsics) {
            scene.camera_mut(id).intrinsics = *intrinsics;
        }
        let is_prior = |prior: &FocalPrior| prior.mean_px.is_finite() && prior.sigma_px.is_finite();
        let num_models = this.finished.models.len();
        let is_step = match this.finished.step {
            Step::Grow => true,
            Step::Join { larger, smaller } => {
                let is_other = |smaller: usize| larger < smaller && smaller < num_models;
                let is_in_work = this.current.is_some();
                larger < num_models
                    && smaller.is_some() == is_in_work
                    && smaller.is_none_or(is_other)
            }
            Step::Merge { index } => (1..=num_models).contains(&index) && this.current.is_none(),
        };
        let is_sound = from.bytes.is_empty()
            && this.intrinsics.len() == scene.num_cameras()
            && scene.validate().is_ok()
            && this.focal_priors.iter().all(is_prior)
            && is_step;
        is_sound.then_some(this)
    }

    fn num_registered(&self) -> usize {
        let mut images = self.finished.mapped_images.clone();
        let current = self.current.iter().map(|current| match current {
            Current::Growing { solution, .. } | Current::Stages { solution, .. } => solution,
        });
        for solution in current {
            images.extend(solution.model.registered().map(|(id, ..)| id));
        }
        images.len()
    }
}

saved! { struct FocalPrior { camera, mean_px, sigma_px } }
saved! { struct Failure { stage, reason } }
saved! { enum OptionalStage { 0 = RollingShutter, 1 = Rig } }
saved! { enum Phase { 0 = Growing, 1 = Complete { noise } } }

/// Standard deviations of the intrinsics of each camera.
type Deviations = BTreeMap<CameraId, Vec<f64>>;

/// Whether there is a deviation for each parameter of a camera.
fn are_sound(deviations: &Deviations, model: &Reconstruction) -> bool {
    deviations.iter().all(|(id, sds)| sds.len() == model.camera(*id).intrinsics.params().len())
}

impl Saved for Solution {
    fn write(&self, to: &mut Writer) {
        let Self {
            model,
            phase,
            initial_pair,
            is_in_frame_of_terms,
            shutters,
            num_loop_pairs,
            rig,
            calibration_evidence,
            kept_intrinsics,
            intrinsics_sds,
            field_sds,
            other_places,
            images_at_lens_test,
        } = self;
        model.write(to);
        phase.write(to);
        initial_pair.write(to);
        is_in_frame_of_terms.write(to);
        shutters.write(to);
        num_loop_pairs.write(to);
        rig.write(to);
        calibration_evidence.write(to);
        kept_intrinsics.write(to);
        intrinsics_sds.write(to);
        field_sds.write(to);
        other_places.write(to);
        images_at_lens_test.write(to);
    }

    fn read(from: &mut Reader) -> Option<Self> {
        let this = Self {
            model: Saved::read(from)?,
            phase: Saved::read(from)?,
            initial_pair: Saved::read(from)?,
            is_in_frame_of_terms: Saved::read(from)?,
            shutters: Saved::read(from)?,
            num_loop_pairs: Saved::read(from)?,
            rig: Saved::read(from)?,
            calibration_evidence: Saved::read(from)?,
            kept_intrinsics: Saved::read(from)?,
            intrinsics_sds: Saved::read(from)?,
            field_sds: Saved::read(from)?,
            other_places: Saved::read(from)?,
            images_at_lens_test: Saved::read(from)?,
        };
        let is_noise = match this.phase {
            Phase::Complete { noise } => noise.is_finite() && noise > 0.0,
            Phase::Growing => true,
        };
        let is_sound = is_noise
            && are_sound(&this.field_sds, &this.model)
            && this.intrinsics_sds.iter().all(|sds| are_sound(sds, &this.model));
        is_sound.then_some(this)
    }
}

saved! { struct OtherPlace { images, connections } }

/// The motion during exposures follows from the rest.
impl Saved for MappedModel {
    fn write(&self, to: &mut Writer) {
        let Self {
            reconstruction,
            initial_pair,
            is_in_frame_of_terms,
            rig,
            calibration_evidence,
            intrinsics_sds,
            shutters,
            row_poses: _,
            num_loop_pairs,
            other_places,
            failures,
        } = self;
        reconstruction.write(to);
        initial_pair.write(to);
        is_in_frame_of_terms.write(to);
        rig.write(to);
        calibration_evidence.write(to);
        intrinsics_sds.write(to);
        shutters.write(to);
        num_loop_pairs.write(to);
        other_places.write(to);
        failures.write(to);
    }

    fn read(from: &mut Reader) -> Option<Self> {
        let mut this = Self {
            reconstruction: Saved::read(from)?,
            initial_pair: Saved::read(from)?,
            is_in_frame_of_terms: Saved::read(from)?,
            rig: Saved::read(from)?,
            calibration_evidence: Saved::read(from)?,
            intrinsics_sds: Saved::read(from)?,
            shutters: Saved::read(from)?,
            row_poses: BTreeMap::new(),
            num_loop_pairs: Saved::read(from)?,
            other_places: Saved::read(from)?,
            failures: Saved::read(from)?,
        };
        this.row_poses = row_poses(&this.reconstruction, &this.shutters);
        are_sound(&this.intrinsics_sds, &this.reconstruction).then_some(this)
    }
}
