//! The entry to the mapper.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use tiepoint_adjust::Term;
use tiepoint_scene::{CorrespondenceGraph, ImageId, KnownRigs, Reconstruction};

use super::checkpoint::{CheckpointStore, Checkpoints, Finished, Step};
use super::existing::ExistingPoses;
use super::extend::extend;
use super::incremental::{initial_focal_lengths, map_rest, without_model};
use super::input::Input;
use super::join::{join_models, registered, sort_by_size};
use super::merge::merge_rig_models;
use super::submap::{assembled, map_part};
use crate::Error;
use crate::event::{Event, Watch};
use crate::mapped_model::MappedModel;
use crate::options::{MapperOptions, RigMode};
use crate::rigs::{Descriptors, rig_pairs};

/// The incremental mapper with its input: the verified pairs, a scene, and what else is known.
pub struct Mapper<'a> {
    graph: &'a CorrespondenceGraph,
    scene: &'a Reconstruction,
    existing: Option<ExistingPoses>,
    submaps: &'a [Vec<u8>],
    known_rigs: Option<&'a KnownRigs>,
    terms: Vec<&'a mut dyn Term>,
    descriptors: Option<&'a mut Descriptors<'a>>,
    watch: Option<&'a mut Watch<'a>>,
    checkpoints: Option<&'a mut (dyn CheckpointStore + 'a)>,
}

impl<'a> Mapper<'a> {
    /// `scene` gives cameras and images with keypoints. Its poses and points are ignored unless
    /// [`Mapper::existing`] is called.
    pub fn new(graph: &'a CorrespondenceGraph, scene: &'a Reconstruction) -> Self {
        Self {
            graph,
            scene,
            existing: None,
            submaps: &[],
            known_rigs: None,
            terms: Vec::new(),
            descriptors: None,
            watch: None,
            checkpoints: None,
        }
    }

    /// Goes on from the poses and points of the scene. The tracks are completed by the
    /// correspondences of the graph, new points are triangulated with the poses, and the images
    /// without a pose are registered one after another. Images that are not connected to this model
    /// give further models, which come behind it.
    ///
    /// The gauge of the model is kept, unless a term has a frame. Poses that are not constant are
    /// refined with all others; the refined model is then moved by the similarity that brings the
    /// poses of the existing images closest to where they were.
    pub fn existing(self, poses: ExistingPoses) -> Self {
        Self { existing: Some(poses), ..self }
    }

    /// Goes on from the models of parts of the images, which [`Mapper::submap`] made with the same
    /// scene and options. They are assembled by the images that they have in common.
    pub fn submaps(self, states: &'a [Vec<u8>]) -> Self {
        Self { submaps: states, ..self }
    }

    /// Grows models of some images, for [`Mapper::submaps`]: a part of
    /// [`crate::submaps::cut`]. Returns their state, which is empty if no model begins. Only the
    /// graph, the scene and the watch take part, and of the graph and the keypoints only those of
    /// the part.
    ///
    /// `first`: the state of the part with whose intrinsics all others begin, before they refine
    /// them; `None` for that part itself.
    ///
    /// # Errors
    ///
    /// An option is out of its range; [`Error::OtherSubmaps`] if `first` is no state of this scene;
    /// [`Error::Cancelled`] if the watch asks to stop.
    pub fn submap(
        self,
        images: &BTreeSet<ImageId>,
        first: Option<&[u8]>,
        options: &MapperOptions,
    ) -> Result<Vec<u8>, Error> {
        options.validate()?;
        let mut go_on = |_: &Event| ControlFlow::Continue(());
        let watch: &mut Watch = match self.watch {
            Some(watch) => watch,
            None => &mut go_on,
        };
        map_part(self.graph, self.scene, images, first, options, watch)
    }

    /// Rigs whose extrinsics are known; their frames are registered as a whole. The models have the
    /// unit of length of the rigs; [`MapperOptions::rig`] has no effect. If no frame of a model has
    /// two images that agree with the extrinsics, its images are registered one by one, and
    /// [`MappedModel::failures`] says so.
    pub fn known_rigs(self, rigs: &'a KnownRigs) -> Self {
        Self { known_rigs: Some(rigs), ..self }
    }

    /// A further term, which takes part in all local and global adjustments of all models, from the
    /// initial pair on. Trials of initial pairs and of focal lengths have no terms, nor has the
    /// pose graph of a loop closure.
    ///
    /// A model is moved into the frame of its terms as soon as one of them knows the similarity
    /// ([`Term::frame`]), and again before each global adjustment. From then on, nothing else fixes
    /// the gauge ([`tiepoint_adjust::Gauge::FixedByTerms`]), and
    /// [`MappedModel::is_in_frame_of_terms`] is set.
    pub fn term(mut self, term: &'a mut dyn Term) -> Self {
        self.terms.push(term);
        self
    }

    /// The descriptors of an image, for guided matching with [`RigMode::Soft`], [`RigMode::Rigid`]
    /// and [`RigMode::Auto`]. Where it returns nothing, no images are matched again.
    pub fn descriptors(self, descriptors: &'a mut Descriptors<'a>) -> Self {
        Self { descriptors: Some(descriptors), ..self }
    }

    /// Receives every event. A `Break` stops the mapper.
    pub fn watch(self, watch: &'a mut (dyn FnMut(&Event) -> ControlFlow<()> + 'a)) -> Self {
        Self { watch: Some(watch), ..self }
    }

    /// Keeps the state of the run from time to time, and goes on from the one that an earlier run
    /// kept, to the same result. A run with terms keeps none: what terms have learned is their own.
    pub fn checkpoints(self, store: &'a mut (dyn CheckpointStore + 'a)) -> Self {
        Self { checkpoints: Some(store), ..self }
    }

    /// Checks the options, and that at most one input gives the frame.
    fn check(&self, options: &MapperOptions) -> Result<(), Error> {
        options.validate()?;
        let (is_extended, has_rigs) = (self.existing.is_some(), self.known_rigs.is_some());
        if is_extended && has_rigs {
            return Err(Error::RigsOfExistingModel);
        }
        let has_frame = is_extended || has_rigs || options.rig == RigMode::Paper;
        if !self.submaps.is_empty() && has_frame {
            return Err(Error::SubmapsWithFrame);
        }
        Ok(())
    }

    /// Maps all images. Each connected component gives a model; the model with the most images
    /// comes first.
    ///
    /// # Errors
    ///
    /// An option is out of its range; there are known rigs and existing poses; the first model
    /// fails; [`Error::NothingToExtend`] if the existing images have no points in common after
    /// triangulation; [`Error::Cancelled`] if the watch asks to stop.
    pub fn run(self, options: &MapperOptions) -> Result<Vec<MappedModel>, Error> {
        self.check(options)?;
        let Self { graph, scene, existing, submaps, known_rigs, mut terms, .. } = self;
        let Self { descriptors, watch, checkpoints, .. } = self;
        let (mut nothing, mut go_on) =
            (|_: ImageId| Default::default(), |_: &Event| ControlFlow::Continue(()));
        let descriptors: &mut Descriptors = match descriptors {
            Some(descriptors) => descriptors,
            None => &mut nothing,
        };
        let watch: &mut Watch = match watch {
            Some(watch) => watch,
            None => &mut go_on,
        };
        let mut options = *options;
        if known_rigs.is_some() {
            options.rig = RigMode::Off;
        }
        options.tracks.two_view |= existing.is_none() && graph.num_images() == 2;
        let options = &options;
        let checkpoints = &mut Checkpoints::new(checkpoints.filter(|_| terms.is_empty()));
        let mut blank = without_model(scene);
        let (focal_priors, finished) = match checkpoints.resume(&mut blank) {
            Some(resumed) => resumed,
            None => (initial_focal_lengths(graph, &mut blank, options), Finished::default()),
        };
        let focal_priors = &focal_priors;
        let rig_pairs = &match options.rig {
            RigMode::Paper => rig_pairs(&blank),
            _ => Vec::new(),
        };
        let input = Input { graph, scene: &blank, options, focal_priors, rig_pairs, known_rigs };
        let Finished { mut models, mut mapped_images, mut step } = finished;
        if let Step::Grow = step {
            let is_extended = existing.is_some();
            if let Some(poses) = existing.filter(|_| models.is_empty()) {
                let first =
                    extend(input, scene, poses, &mut terms, descriptors, watch, checkpoints)?;
                mapped_images = registered(&first.reconstruction);
                models.push(first);
            }
            let starts = assembled(input, submaps)?;
            models = map_rest(
                input,
                &starts,
                (models, mapped_images),
                &mut terms,
                descriptors,
                watch,
                checkpoints,
            )?;
            if is_extended {
                return Ok(models);
            }
            sort_by_size(&mut models);
            step = Step::Join { larger: 0, smaller: None };
        }
        if let Step::Join { larger, smaller } = step {
            if known_rigs.is_none() {
                let at = (larger, smaller);
                join_models(input, &mut models, at, &mut terms, descriptors, watch, checkpoints)?;
            }
            step = Step::Merge { index: 1 };
        }
        if let Step::Merge { index } = step
            && matches!(options.rig, RigMode::Soft | RigMode::Rigid | RigMode::Auto)
        {
            merge_rig_models(
                input,
                &mut models,
                index,
                &mut terms,
                descriptors,
                watch,
                checkpoints,
            )?;
        }
        // Joined and merged models may have outgrown others.
        sort_by_size(&mut models);
        Ok(models)
    }
}
