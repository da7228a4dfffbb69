//! Growth of one model: initialisation, registration of one image after another, and bundle
//! adjustment.
//!
//! After Schönberger & Frahm 2016. Random streams are keyed by (seed, images), and parallel results
//! are collected in order. The result depends only on the input, the options and the seed.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_adjust::{
    AdjustOptions, FocalPrior, RefineIntrinsics, Scope, Term, adjust, keep_going, relative_noise,
};
use tiepoint_geometry::{Rigid3, Rng};
use tiepoint_scene::{CorrespondenceGraph, ImageId, ImagePair, KnownRigs, Reconstruction};

use super::refinement_schedule::RefinementSchedule;
use super::solution::Solution;
use crate::Error;
use crate::event::{Event, Watch, notify};
use crate::known_frames::KnownFrames;
use crate::options::{MapperOptions, RigMode};
use crate::register::NextBestView;
use crate::rigs::{BaselineLink, BaselineTerm, RigPairs, growing_links};
use crate::tracks::{
    complete_tracks, filter_all_points, filter_images, filter_points, merge_tracks,
    triangulate_image, update_tracks,
};

/// A refinement ends when the number of observations and the cost change by less than this
/// fraction.
const MIN_CHANGE: f64 = 5e-4;
/// Minimum number of images for refining the distortion.
const MIN_IMAGES_FOR_DISTORTION: usize = 5;
/// Minimum rotation of a camera (20°) for refining focal length and principal point. From pure
/// translation these are ambiguous: the points can be sheared and stretched to fit other values.
const MIN_ROTATION_RAD: f64 = 0.35;

/// A model under construction.
pub(super) struct Mapper<'a> {
    pub(super) graph: &'a CorrespondenceGraph,
    pub(super) options: &'a MapperOptions,
    pub(super) focal_priors: &'a [FocalPrior],
    /// Camera pairs of the paper's rig term.
    pub(super) rig_pairs: &'a [RigPairs],
    /// Rigs with known extrinsics.
    pub(super) known_rigs: Option<&'a KnownRigs>,
    /// Images of earlier models.
    pub(super) mapped_images: BTreeSet<ImageId>,
    /// Number of images at which growth stops, in a trial of an initial pair or of focal lengths;
    /// `None` for all images.
    pub(super) max_images: Option<usize>,
    /// Images whose poses are constant, and which always stay registered.
    pub(super) constant_poses: Option<&'a BTreeSet<ImageId>>,
    /// Poses of the model that is extended.
    pub(super) existing_poses: &'a [(ImageId, Rigid3)],
    pub(super) next_best_view: NextBestView,
    /// The initial pair.
    pub(super) initial: Option<ImagePair>,
    pub(super) solution: Solution,
}

impl<'a> Mapper<'a> {
    pub(super) fn new(
        graph: &'a CorrespondenceGraph,
        scene: &Reconstruction,
        options: &'a MapperOptions,
    ) -> Self {
        Self {
            graph,
            options,
            focal_priors: &[],
            rig_pairs: &[],
            known_rigs: None,
            mapped_images: BTreeSet::new(),
            max_images: None,
            constant_poses: None,
            existing_poses: &[],
            next_best_view: NextBestView::new(scene, KnownFrames::default(), options.seed),
            initial: None,
            solution: Solution::new(scene.clone()),
        }
    }

    /// Registers frames of these rigs as a whole, without the images of earlier models.
    pub(super) fn use_rigs(&mut self, rigs: &'a KnownRigs) {
        let scene = &self.solution.model;
        let frames = KnownFrames::new(rigs, scene, &self.mapped_images);
        self.next_best_view = NextBestView::new(scene, frames, self.options.seed);
        self.known_rigs = Some(rigs);
    }

    /// Estimates the noise scale of the keypoints, which later adjustments use.
    pub(super) fn estimate_noise(&mut self) {
        self.solution.noise = Some(relative_noise(&self.solution.model));
    }

    /// Registers all images that can be registered, with local and global adjustments.
    pub(super) fn grow(&mut self, watch: &mut Watch) -> Result<(), Error> {
        self.start_frames(watch)?;
        let mut images_at_global = self.solution.model.num_registered();
        let mut points_at_global = self.solution.model.num_tracks();
        loop {
            while let Some(image) = self.register_next() {
                self.add_image(image, watch)?;
                let (images, points) =
                    (self.solution.model.num_registered(), self.solution.model.num_tracks());
                let grown = |now: usize, then: usize| {
                    now as f64 >= self.options.global_growth * then as f64
                };
                if grown(images, images_at_global) || grown(points, points_at_global) {
                    self.refine_globally(&RefinementSchedule::GROWING, watch)?;
                    (images_at_global, points_at_global) =
                        (self.solution.model.num_registered(), self.solution.model.num_tracks());
                }
            }
            // Registration that failed before the last refinement may succeed after it.
            self.refine_globally(&RefinementSchedule::GROWING, watch)?;
            self.next_best_view.reset_trials();
            // Retries one failed image.
            let Some(image) = self.register_next() else { return Ok(()) };
            self.add_image(image, watch)?;
        }
    }

    /// Triangulates the points of a new image and of its frame, adjusts it with its neighbours, and
    /// reports it.
    fn add_image(&mut self, image: ImageId, watch: &mut Watch) -> Result<(), Error> {
        let images = self.next_best_view.frames().registered_with(&self.solution.model, image);
        for &image in &images {
            triangulate_image(self.graph, &mut self.solution.model, image, &self.options.tracks);
        }
        self.adjust_locally(&images)?;
        images.iter().try_for_each(|&image| self.report(image, watch))?;
        self.start_frames(watch)
    }

    /// Returns the unregistered images with a verified pair to a registered image; of a frame its
    /// first image.
    fn frontier(&self) -> Vec<ImageId> {
        let has_pose = |id: &ImageId| self.solution.model.image(*id).cam_from_world().is_some();
        let is_unregistered = |id: &ImageId| !self.mapped_images.contains(id) && !has_pose(id);
        let is_next = |id: &ImageId| self.graph.neighbours(*id).iter().any(has_pose);
        let images = self.solution.model.images().map(|(id, _)| id);
        let mut images: Vec<ImageId> = images.filter(is_unregistered).filter(is_next).collect();
        if !self.solution.model.rigs.is_empty() {
            let frames = self.next_best_view.frames();
            let first_of = |image: &ImageId| frames.first_of(&self.solution.model, *image);
            let firsts: BTreeSet<ImageId> = images.iter().map(first_of).collect();
            images = firsts.into_iter().filter(is_unregistered).collect();
        }
        images
    }

    /// Registers the next image; `None` if no image can be registered.
    fn register_next(&mut self) -> Option<ImageId> {
        if self.max_images.is_some_and(|most| self.solution.model.num_registered() >= most) {
            return None;
        }
        let images = self.frontier();
        self.next_best_view.register_next(
            self.graph,
            &mut self.solution.model,
            images,
            &self.options.register,
        )
    }

    /// Adjusts the new images with the images that share most points with them, and their frames.
    fn adjust_locally(&mut self, images: &[ImageId]) -> Result<(), Error> {
        let model = &self.solution.model;
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
        let local_images: BTreeSet<ImageId> = images
            .iter()
            .copied()
            .chain(neighbours.take(self.options.local_images - 1))
            .flat_map(|image| frames.registered_with(model, image))
            .filter(|image| model.image(*image).cam_from_world().is_some())
            .collect();
        let links = growing_links(&self.solution.model, self.rig_pairs);
        let options = self.adjust_options(&RefinementSchedule::LOCAL);
        let terms: &mut [&mut dyn Term] = &mut [&mut BaselineTerm { links: &links }];
        match adjust(
            &mut self.solution.model,
            &Scope::Local(&local_images),
            &options,
            terms,
            &mut keep_going,
        ) {
            Ok(_) | Err(tiepoint_adjust::Error::NothingToAdjust { .. }) => {}
            Err(error) => return Err(error.into()),
        }
        let points = self.solution.model.points_observed_by(&local_images);
        complete_tracks(self.graph, &mut self.solution.model, &points, &self.options.tracks);
        merge_tracks(self.graph, &mut self.solution.model, &points, &self.options.tracks);
        let points = self.solution.model.points_observed_by(&local_images);
        filter_points(&mut self.solution.model, &points, &self.options.filter);
        Ok(())
    }

    /// Updates the tracks, adjusts and filters until the changes are small.
    pub(super) fn refine_globally(
        &mut self,
        schedule: &RefinementSchedule,
        watch: &mut Watch,
    ) -> Result<(), Error> {
        let mut before = (self.solution.model.num_observations(), f64::INFINITY);
        for _ in 0..schedule.rounds {
            update_tracks(self.graph, &mut self.solution.model, &self.options.tracks);
            let links = growing_links(&self.solution.model, self.rig_pairs);
            let after = self.adjust_globally(&links, schedule, watch)?;
            let changed = |now: f64, then: f64| (now - then).abs() >= MIN_CHANGE * now.abs();
            if !changed(after.0 as f64, before.0 as f64) && !changed(after.1, before.1) {
                break;
            }
            before = after;
        }
        Ok(())
    }

    /// Runs global bundle adjustment and filters. Returns the number of observations and the cost.
    pub(super) fn adjust_globally(
        &mut self,
        links: &[BaselineLink],
        schedule: &RefinementSchedule,
        watch: &mut Watch,
    ) -> Result<(usize, f64), Error> {
        let options = self.adjust_options(schedule);
        let terms: &mut [&mut dyn Term] = &mut [&mut BaselineTerm { links }];
        let summary =
            adjust(&mut self.solution.model, &Scope::Global, &options, terms, &mut keep_going)?;
        filter_all_points(&mut self.solution.model, &self.options.filter);
        let constant = self.constant_poses;
        filter_images(
            &mut self.solution.model,
            self.options.register.min_num_inliers / 2,
            &|image| constant.is_some_and(|images| images.contains(&image)),
        );
        let (num_observations, cost) = (self.solution.model.num_observations(), summary.final_cost);
        let (num_images, iterations) =
            (self.solution.model.num_registered(), summary.iterations.len());
        notify(watch, &Event::Adjusted { num_images, num_observations, cost, iterations })?;
        Ok((num_observations, cost))
    }

    /// Options of an adjustment: intrinsics are refined as far as the registered images determine
    /// them. The noise scale is estimated at the end of growth, so that its presence tells the
    /// complete model from a growing one.
    pub(super) fn adjust_options(&self, schedule: &RefinementSchedule) -> AdjustOptions<'a> {
        let mut refine = self.options.refine;
        let has_rotation = self.has_rotation();
        refine.focal &= self.solution.noise.is_some() || has_rotation;
        refine.principal_point &= self.solution.noise.is_some() && has_rotation;
        if self.solution.model.num_registered() < MIN_IMAGES_FOR_DISTORTION {
            refine = RefineIntrinsics {
                focal: refine.focal,
                aspect: refine.aspect,
                ..RefineIntrinsics::NONE
            };
        }
        if self.solution.model.num_registered() < 3 {
            refine = RefineIntrinsics::NONE;
        }
        let options = AdjustOptions {
            refine,
            select_tracks: schedule.select_tracks,
            loss: self.options.loss,
            focal_priors: self.focal_priors,
            constant_poses: self.constant_poses,
            gauge: self.initial.filter(|_| self.options.rig == RigMode::Paper),
            constant_rigs: self.known_rigs.is_some_and(|known| !known.refine_extrinsics),
            max_iterations: schedule.max_iterations,
            function_tolerance: schedule.tolerance,
            ..AdjustOptions::default()
        };
        match self.solution.noise {
            Some(noise) => options.with_noise(noise),
            // The residuals of a growing model show the errors of its poses, not keypoint noise.
            None => options,
        }
    }

    /// Whether some image is rotated relative to the first image of its camera. Two cameras of a
    /// rig have different orientations without rotating. If each image has its own camera, images
    /// are compared with each other.
    fn has_rotation(&self) -> bool {
        let is_shared =
            self.solution.model.cameras().count() < self.solution.model.images().count();
        let mut first = BTreeMap::new();
        self.solution.model.registered().any(|(_, image, pose)| {
            let camera = is_shared.then_some(image.camera);
            first.entry(camera).or_insert(pose.rotation).angle_to(&pose.rotation) > MIN_ROTATION_RAD
        })
    }

    pub(super) fn seed_of(&self, key: &[u64]) -> u64 {
        Rng::stream(self.options.seed, key).next_u64()
    }

    pub(super) fn report(&self, image: ImageId, watch: &mut Watch) -> Result<(), Error> {
        let event = Event::Registered {
            image,
            num_registered: self.solution.model.num_registered(),
            num_images: self.solution.model.images().count() - self.mapped_images.len(),
            num_points: self.solution.model.num_tracks(),
        };
        notify(watch, &event)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::ops::ControlFlow;

    use tiepoint_synth::MatchOptions;

    use super::*;
    use crate::mapper::test_scene::scene;
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
        let mut mapper = Mapper::new(&graph, &blank, &options);
        let candidates = mapper.candidates();
        let pair = mapper
            .initialise(&candidates, &mut |_| ControlFlow::Continue(()))
            .expect("an easy scene");
        let failing = *mapper.frontier().last().expect("there are more images");
        let impossible = RegisterOptions { min_inlier_ratio: 1.1, ..options.register };
        for _ in 0..TRIALS {
            let model = &mut mapper.solution.model;
            let found =
                mapper.next_best_view.register_next(&graph, model, vec![failing], &impossible);
            assert_eq!(found, None);
        }
        let mut reported = BTreeSet::from([pair.a, pair.b]);
        let mut watch = |event: &Event| {
            if let Event::Registered { image, .. } = event {
                reported.insert(*image);
            }
            ControlFlow::Continue(())
        };
        mapper.grow(&mut watch).expect("an easy scene");
        let registered: BTreeSet<ImageId> =
            mapper.solution.model.registered().map(|(id, ..)| id).collect();
        assert_eq!(registered.len(), blank.images().count());
        assert_eq!(reported, registered);
    }
}
