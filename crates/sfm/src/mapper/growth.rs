//! Growth of one model: registration of one image after another.
//!
//! After Schönberger & Frahm 2016. Random streams are keyed by (seed, images), and parallel results
//! are collected in order. The result depends only on the input, the options and the seed.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_scene::{ImageId, Reconstruction};

use super::camera_models::{GROWTH, GROWTH_AT_END};
use super::checkpoint::{Checkpoints, Current};
use super::input::Input;
use super::refinement_schedule::RefinementSchedule;
use super::refiner::Refiner;
use super::solution::Solution;
use crate::Error;
use crate::event::{Event, Watch, notify};
use crate::known_frames::KnownFrames;
use crate::mapped_model::MappedModel;
use crate::register::{Evidence, NextBestView, contradicted};
use crate::rigs::Descriptors;
use crate::tracks::{TrackOptions, filter_all_points, triangulate_image};

/// Minimum angle of points that register one image and then are filtered as all are (0.5°). With an
/// error of a pixel, such a point misses an image that sees it at an angle of 4° by √2 · 4 / 0.5 =
/// 11 px, less than the threshold of registration.
const MIN_WEAK_ANGLE_RAD: f64 = 0.0087;

/// A growing model.
pub(super) struct Growth<'a> {
    pub(super) refiner: Refiner<'a>,
    /// Images of earlier models.
    pub(super) mapped_images: BTreeSet<ImageId>,
    extent: Extent,
    pub(super) next_best_view: NextBestView,
}

/// Which images a model may get.
#[derive(Clone, Copy, Debug)]
enum Extent {
    /// All that can be registered.
    All,
    /// A trial of an initial pair or of focal lengths.
    Trial { max_images: usize },
    /// Those that another model has and that do not wait for others, until it overlaps enough.
    Overlap { max_images: usize },
}

impl<'a> Growth<'a> {
    /// Grows the model of a refiner by images that are in no earlier model. Frames of known rigs
    /// are registered as a whole.
    pub(super) fn new(refiner: Refiner<'a>, mapped_images: BTreeSet<ImageId>) -> Self {
        let scene = &refiner.solution.model;
        let frames = refiner.input.known_rigs;
        let frames = frames.map(|rigs| KnownFrames::new(rigs, scene, &mapped_images));
        let seed = refiner.input.options.seed;
        let graph = refiner.input.graph;
        let next_best_view = NextBestView::new(graph, scene, frames.unwrap_or_default(), seed);
        Self { refiner, mapped_images, extent: Extent::All, next_best_view }
    }

    /// A small model, which tells how well the images support a hypothesis. It has no further
    /// terms: the support is that of the images alone, and what a term learns from a wrong model
    /// could not be undone.
    pub(super) fn trial(
        input: Input<'a>,
        mapped_images: BTreeSet<ImageId>,
        max_images: usize,
    ) -> Self {
        let refiner = Refiner::new(input, input.scene.clone(), Vec::new());
        Self { extent: Extent::Trial { max_images }, ..Self::new(refiner, mapped_images) }
    }

    /// Grows a model by images of another one, all that are not in `mapped_images`.
    pub(super) fn overlap(
        refiner: Refiner<'a>,
        mapped_images: BTreeSet<ImageId>,
        max_images: usize,
    ) -> Self {
        let extent = Extent::Overlap { max_images };
        let mut growth = Self { extent, ..Self::new(refiner, mapped_images) };
        let Refiner { input, solution, .. } = &growth.refiner;
        growth.next_best_view.learn_recalls(input.graph, &solution.model, &input.options.register);
        growth
    }

    pub(super) fn model(&self) -> &Reconstruction {
        &self.refiner.solution.model
    }

    /// Registers all images that can be registered, and runs the stages after that; goes on from
    /// what an earlier run was doing.
    pub(super) fn finish(
        mut self,
        descriptors: &mut Descriptors,
        watch: &mut Watch,
        checkpoints: &mut Checkpoints,
    ) -> Result<MappedModel, Error> {
        let at_global = match checkpoints.resumed.take() {
            Some(Current::Growing { solution, history, at_global }) => {
                self.refiner.solution = *solution;
                self.next_best_view.restore(history);
                at_global
            }
            Some(Current::Stages { solution, next, failures }) => {
                self.refiner.solution = *solution;
                return self.refiner.run_stages_from(
                    next,
                    failures,
                    descriptors,
                    watch,
                    checkpoints,
                );
            }
            None => {
                self.start_frames(watch)?;
                self.size()
            }
        };
        self.grow_on(at_global, watch, checkpoints)?;
        self.refiner.run_stages(descriptors, watch, checkpoints)
    }

    /// Registers all images that can be registered, with local and global adjustments.
    pub(super) fn grow(&mut self, watch: &mut Watch) -> Result<(), Error> {
        self.start_frames(watch)?;
        self.grow_on(self.size(), watch, &mut Checkpoints::none())
    }

    /// [`Growth::grow`] from the state of a checkpoint: `at_global` are the numbers of images and
    /// points at the last global adjustment.
    fn grow_on(
        &mut self,
        mut at_global: (usize, usize),
        watch: &mut Watch,
        checkpoints: &mut Checkpoints,
    ) -> Result<(), Error> {
        loop {
            while let Some(image) = self.register_usual() {
                self.add_image(image, watch)?;
                let (images, points) = self.size();
                let factor = self.refiner.input.options.global_growth;
                let grown = |now: usize, then: usize| now as f64 >= factor * then as f64;
                if grown(images, at_global.0) || grown(points, at_global.1) {
                    self.refiner.refine_globally(&RefinementSchedule::GROWING, watch)?;
                    self.select_camera_models(GROWTH, watch)?;
                    at_global = self.size();
                }
                self.keep_checkpoint(at_global, checkpoints);
            }
            // Registration that failed before the last refinement may succeed after it.
            self.refiner.refine_globally(&RefinementSchedule::GROWING, watch)?;
            self.select_camera_models(GROWTH_AT_END, watch)?;
            self.next_best_view.reset_trials();
            // Retries one failed image.
            let next = self.register_usual().or_else(|| self.register_weak());
            let Some(image) = next else {
                if self.remove_contradicted() || self.leave_other_place(watch)? {
                    continue;
                }
                return Ok(());
            };
            self.add_image(image, watch)?;
            self.keep_checkpoint(at_global, checkpoints);
        }
    }

    /// Selects camera models, except in trials and overlaps.
    fn select_camera_models(&mut self, growth: f64, watch: &mut Watch) -> Result<(), Error> {
        match self.extent {
            Extent::All => self.refiner.select_camera_models(growth, watch),
            Extent::Trial { .. } | Extent::Overlap { .. } => Ok(()),
        }
    }

    /// Numbers of registered images and of points.
    fn size(&self) -> (usize, usize) {
        (self.model().num_registered(), self.model().num_tracks())
    }

    fn keep_checkpoint(&self, at_global: (usize, usize), checkpoints: &mut Checkpoints) {
        let Refiner { input, solution, .. } = &self.refiner;
        checkpoints.growing(input.scene, solution, &self.next_best_view, at_global);
    }

    /// Removes the images that their camera cannot have reached between those before and after
    /// them, and those that do not see what others see; whether there were any. They may be
    /// registered again, now that none misleads another.
    fn remove_contradicted(&mut self) -> bool {
        if !self.may_lose_images() {
            return false;
        }
        let Input { graph, options, .. } = self.refiner.input;
        let model = &mut self.refiner.solution.model;
        let num_registered = model.num_registered();
        // Poses that were given are no result of a growth.
        let is_new = self.refiner.existing.is_none();
        while is_new && let Some(part) = self.next_best_view.part_out_of_reach(model) {
            part.iter().for_each(|image| model.deregister(*image));
        }
        while let Some(image) = contradicted(graph, model) {
            model.deregister(image);
        }
        let is_changed = model.num_registered() < num_registered;
        if is_changed {
            filter_all_points(model, &options.filter);
        }
        is_changed
    }

    /// Leaves the images of the smaller of two places that look alike to another model; whether the
    /// model held two places as one.
    fn leave_other_place(&mut self, watch: &mut Watch) -> Result<bool, Error> {
        if !self.may_lose_images() {
            return Ok(false);
        }
        let Some(found) = self.refiner.other_place() else { return Ok(false) };
        let Solution { model, other_places, .. } = &mut self.refiner.solution;
        found.images.iter().for_each(|image| model.deregister(*image));
        filter_all_points(model, &self.refiner.input.options.filter);
        let (num_images, num_others) = (model.num_registered(), found.images.len());
        other_places.push(found);
        notify(watch, &Event::Divided { num_images, num_others })?;
        Ok(true)
    }

    /// Whether images may leave a model that has grown: none of those with known poses.
    fn may_lose_images(&self) -> bool {
        let has_rigs = self.refiner.input.known_rigs.is_some();
        matches!(self.extent, Extent::All) && !has_rigs && self.refiner.constant_poses().is_none()
    }

    /// Registers an image with the usual evidence, which also takes deferred images in the end.
    fn register_usual(&mut self) -> Option<ImageId> {
        if matches!(self.extent, Extent::Overlap { .. }) {
            return None;
        }
        self.register_next(Evidence::Usual)
    }

    /// Registers an image with less evidence, where nothing else is left: first with the points of
    /// the model, then also with points of small angles. Trials compare the support of usual
    /// images.
    fn register_weak(&mut self) -> Option<ImageId> {
        if matches!(self.extent, Extent::Trial { .. }) {
            return None;
        }
        let next = self.register_next(Evidence::Significant);
        if next.is_some() {
            return next;
        }
        let images = self.frontier();
        let Input { graph, options, .. } = self.refiner.input;
        let model = &mut self.refiner.solution.model;
        let has_pose = |image: &ImageId| model.image(*image).cam_from_world().is_some();
        let neighbours = images.iter().flat_map(|image| graph.neighbours(*image));
        let neighbours: BTreeSet<ImageId> = neighbours.copied().filter(has_pose).collect();
        if neighbours.is_empty() {
            return None;
        }
        let tracks = TrackOptions { min_angle_rad: MIN_WEAK_ANGLE_RAD, ..options.tracks };
        for image in neighbours {
            triangulate_image(graph, model, image, &tracks);
        }
        let next = self.register_next(Evidence::Significant);
        if next.is_none() {
            filter_all_points(&mut self.refiner.solution.model, &options.filter);
        }
        next
    }

    /// Triangulates the points of a new image and of its frame, adjusts it with its neighbours, and
    /// reports it.
    fn add_image(&mut self, image: ImageId, watch: &mut Watch) -> Result<(), Error> {
        let images = self.next_best_view.frames().registered_with(self.model(), image);
        images.iter().for_each(|image| self.triangulate(*image));
        let local_images = self.local_images(&images);
        self.refiner.adjust_locally(&local_images)?;
        images.iter().try_for_each(|&image| self.report(image, watch))?;
        self.start_frames(watch)
    }

    pub(super) fn triangulate(&mut self, image: ImageId) {
        let Input { graph, options, .. } = self.refiner.input;
        triangulate_image(graph, &mut self.refiner.solution.model, image, &options.tracks);
    }

    /// Returns the unregistered images with a verified pair to a registered image; of a frame its
    /// first image.
    fn frontier(&self) -> Vec<ImageId> {
        let (model, graph) = (self.model(), self.refiner.input.graph);
        let has_pose = |id: &ImageId| model.image(*id).cam_from_world().is_some();
        let Solution { other_places, .. } = &self.refiner.solution;
        let is_other = |id: &ImageId| other_places.iter().any(|place| place.images.contains(id));
        let is_open = |id: &ImageId| !self.mapped_images.contains(id) && !is_other(id);
        let is_unregistered = |id: &ImageId| is_open(id) && !has_pose(id);
        let is_next = |id: &ImageId| graph.neighbours(*id).iter().any(has_pose);
        let images = model.images().map(|(id, _)| id);
        let mut images: Vec<ImageId> = images.filter(is_unregistered).filter(is_next).collect();
        if !model.rigs.is_empty() {
            let frames = self.next_best_view.frames();
            let first_of = |image: &ImageId| frames.first_of(model, *image);
            let firsts: BTreeSet<ImageId> = images.iter().map(first_of).collect();
            images = firsts.into_iter().filter(is_unregistered).collect();
        }
        images
    }

    /// Registers the next image; `None` if no image can be registered.
    fn register_next(&mut self, evidence: Evidence) -> Option<ImageId> {
        if let Extent::Trial { max_images } | Extent::Overlap { max_images } = self.extent
            && self.model().num_registered() >= max_images
        {
            return None;
        }
        let images = self.frontier();
        let Input { graph, options, .. } = self.refiner.input;
        let model = &mut self.refiner.solution.model;
        self.next_best_view.register_next(graph, model, images, &options.register, evidence)
    }

    /// The new images with the images that share most points with them, and their frames.
    fn local_images(&self, images: &[ImageId]) -> BTreeSet<ImageId> {
        let model = self.model();
        let mut shared: BTreeMap<ImageId, usize> = BTreeMap::new();
        let points = images.iter().flat_map(|image| model.image(*image).points().iter().flatten());
        for track in points.filter_map(|point| model.track(*point)) {
            for observation in track.observations.iter().filter(|o| !images.contains(&o.image)) {
                *shared.entry(observation.image).or_insert(0) += 1;
            }
        }
        let mut neighbours: Vec<(usize, ImageId)> =
            shared.into_iter().map(|(id, count)| (count, id)).collect();
        neighbours.sort_by_key(|(count, id)| (std::cmp::Reverse(*count), *id));
        let neighbours = neighbours.into_iter().map(|(_, id)| id);
        let frames = self.next_best_view.frames();
        images
            .iter()
            .copied()
            .chain(neighbours.take(self.refiner.input.options.local_images - 1))
            .flat_map(|image| frames.registered_with(model, image))
            .filter(|image| model.image(*image).cam_from_world().is_some())
            .collect()
    }

    pub(super) fn report(&self, image: ImageId, watch: &mut Watch) -> Result<(), Error> {
        let event = Event::Registered {
            image,
            num_registered: self.model().num_registered(),
            num_images: self.model().images().count() - self.mapped_images.len(),
            num_points: self.model().num_tracks(),
        };
        notify(watch, &event)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::ops::ControlFlow;

    use tiepoint_adjust::RefineIntrinsics;
    use tiepoint_synth::MatchOptions;

    use super::*;
    use crate::mapper::test_scene::scene;
    use crate::options::MapperOptions;
    use crate::register::RegisterOptions;

    /// More than the number of failed trials that an image may have.
    const TRIALS: usize = 4;

    /// An image that failed is registered after the refinement of the others, and reported like
    /// them.
    #[test]
    fn every_image_is_reported_including_one_that_had_failed() {
        let scene = scene();
        let graph = scene.graph(&MatchOptions::default());
        let options = MapperOptions { refine: RefineIntrinsics::NONE, ..MapperOptions::default() };
        let blank = scene.without_poses();
        let input = Input::of_trial(&graph, &blank, &options);
        let refiner = Refiner::new(input, blank.clone(), Vec::new());
        let mut growth = Growth::new(refiner, BTreeSet::new());
        let candidates = growth.candidates();
        let pair = growth
            .initialise(&candidates, &mut |_| ControlFlow::Continue(()))
            .expect("an easy scene");
        let failing = *growth.frontier().last().expect("there are more images");
        let impossible = RegisterOptions { min_inlier_ratio: 1.1, ..options.register };
        for _ in 0..TRIALS {
            let model = &mut growth.refiner.solution.model;
            let images = vec![failing];
            let next = &mut growth.next_best_view;
            let found = next.register_next(&graph, model, images, &impossible, Evidence::Usual);
            assert_eq!(found, None);
        }
        let mut reported = BTreeSet::from([pair.a, pair.b]);
        let mut watch = |event: &Event| {
            if let Event::Registered { image, .. } = event {
                reported.insert(*image);
            }
            ControlFlow::Continue(())
        };
        growth.grow(&mut watch).expect("an easy scene");
        let registered: BTreeSet<ImageId> =
            growth.model().registered().map(|(id, ..)| id).collect();
        assert_eq!(registered.len(), blank.images().count());
        assert_eq!(reported, registered);
    }
}
