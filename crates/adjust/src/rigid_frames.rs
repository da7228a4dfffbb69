//! Rigs and frames of a model in bundle adjustment.
//!
//! The pose of an image in a frame is composed: `cam_from_rig` · `rig_from_world`. If the reference
//! sensor's image has observations, `rig_from_world` is that image's pose, and otherwise it is a
//! variable of its own. `cam_from_rig` of each other sensor is one variable, constant if no
//! observation determines it. In a local adjustment all `cam_from_rig` are constant, since most
//! frames take no part. There a frame moves if its reference image moves or, without one, if any of
//! its images does.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_ba::{EliminationOrder, Key, Problem};
use tiepoint_geometry::Rigid3;
use tiepoint_scene::{CameraId, Frame, ImageId, Reconstruction, Rig};

use crate::Error;
use crate::options::{AdjustOptions, Scope};
use crate::term::{Term, TermContext};
use crate::variables::Variables;

/// The rigs and frames of a model, and their variables.
pub(crate) struct RigidFrames {
    rigs: Vec<Rig>,
    frames: Vec<Frame>,
    cameras: BTreeMap<ImageId, CameraId>,
    /// Images with composed poses, and their positions in the order of the poses.
    composed: BTreeMap<ImageId, u32>,
    cam_from_rig: BTreeMap<(usize, usize), Key<Rigid3>>,
    /// Whether all `cam_from_rig` are constant.
    constant_rigs: bool,
    /// Images whose poses are constant.
    constant_poses: BTreeSet<ImageId>,
    rig_from_world: Vec<Option<Key<Rigid3>>>,
}

impl RigidFrames {
    pub(crate) fn new(model: &Reconstruction, options: &AdjustOptions) -> Self {
        let images = model.frames.iter().flat_map(|frame| &frame.images);
        Self {
            rigs: model.rigs.clone(),
            frames: model.frames.clone(),
            cameras: images.map(|image| (*image, model.image(*image).camera)).collect(),
            composed: BTreeMap::new(),
            cam_from_rig: BTreeMap::new(),
            constant_rigs: options.constant_rigs,
            constant_poses: options.constant_poses.cloned().unwrap_or_default(),
            rig_from_world: vec![None; model.frames.len()],
        }
    }

    /// Returns the index of an image's camera among the sensors of the frame's rig, and its
    /// `cam_from_rig`.
    fn sensor_of(&self, frame: &Frame, image: ImageId) -> Option<(usize, Rigid3)> {
        let sensors = &self.rigs.get(frame.rig.index())?.sensors;
        let sensor = sensors.iter().position(|sensor| sensor.camera == self.cameras[&image])?;
        let cam_from_rig =
            if sensor == 0 { Rigid3::identity() } else { sensors[sensor].cam_from_rig? };
        Some((sensor, cam_from_rig))
    }

    /// Whether the image has a composed pose: its sensor is not the reference sensor.
    fn is_composed(&self, frame: &Frame, image: ImageId) -> bool {
        self.sensor_of(frame, image).is_some_and(|(sensor, _)| sensor > 0)
    }

    /// Returns the sensors, as (rig, sensor), whose `cam_from_rig` must be constant to remove a
    /// gauge freedom.
    ///
    /// Two sensors are connected if some frame has observed images of both. A group of connected
    /// sensors that does not contain the reference sensor can move as a whole against the rest of
    /// the rig, so its first sensor is returned.
    fn undetermined(&self, is_observed: impl Fn(ImageId) -> bool) -> BTreeSet<(usize, usize)> {
        // For each sensor, the first sensor of its group.
        let mut first: BTreeMap<(usize, usize), usize> = BTreeMap::new();
        for frame in &self.frames {
            let rig = frame.rig.index();
            let observed = frame.images.iter().filter(|image| is_observed(**image));
            let sensors_seen: Vec<usize> = observed
                .filter_map(|image| self.sensor_of(frame, *image))
                .map(|(sensor, _)| sensor)
                .collect();
            let groups: BTreeSet<usize> = sensors_seen
                .iter()
                .map(|sensor| *first.entry((rig, *sensor)).or_insert(*sensor))
                .collect();
            let Some(&least) = groups.first() else { continue };
            let of_rig = first.range_mut((rig, 0)..=(rig, usize::MAX));
            of_rig
                .filter(|(_, group)| groups.contains(group))
                .for_each(|(_, group)| *group = least);
        }
        first
            .into_iter()
            .filter(|((_, sensor), group)| *sensor > 0 && sensor == group)
            .map(|(key, _)| key)
            .collect()
    }

    /// Writes rigs, frames and the poses of their images to the model.
    pub(crate) fn write_back(self, model: &mut Reconstruction) {
        for frame in &self.frames {
            for &image in &frame.images {
                if let Some((_, cam_from_rig)) = self.sensor_of(frame, image)
                    && model.image(image).cam_from_world().is_some()
                {
                    model.register(image, cam_from_rig * frame.rig_from_world);
                }
            }
        }
        (model.rigs, model.frames) = (self.rigs, self.frames);
    }
}

impl Term for RigidFrames {
    fn composed_images(&mut self, posed: &[ImageId]) -> Vec<ImageId> {
        for frame in &self.frames {
            for &image in &frame.images {
                if let Ok(order) = posed.binary_search(&image)
                    && self.is_composed(frame, image)
                {
                    self.composed.insert(image, order as u32);
                }
            }
        }
        self.composed.keys().copied().collect()
    }

    /// Adds `rig_from_world` of each frame without an observed reference image, and `cam_from_rig`
    /// of each other sensor, and composes the poses of the images.
    fn add(&mut self, context: &TermContext, variables: &mut Variables) -> Result<(), Error> {
        let is_constant = self.constant_rigs || matches!(context.scope, Scope::Local(_));
        let pose_keys: BTreeMap<ImageId, Key<Rigid3>> = variables.poses().iter().copied().collect();
        let undetermined = self.undetermined(|image| {
            pose_keys.contains_key(&image) || self.composed.contains_key(&image)
        });
        for (index, frame) in self.frames.iter().enumerate() {
            let reference = frame.images.iter().find(|image| {
                self.sensor_of(frame, **image).is_some_and(|(sensor, _)| sensor == 0)
                    && pose_keys.contains_key(image)
            });
            let composed_images_of_frame =
                || frame.images.iter().filter(|image| self.composed.contains_key(image));
            let rig_from_world = match (reference, composed_images_of_frame().next()) {
                (Some(image), _) => pose_keys[image],
                (None, Some(first)) => {
                    let key = variables.problem_mut().add_parameter(
                        frame.rig_from_world,
                        EliminationOrder::At(self.composed[first]),
                    );
                    let is_variable = |image: &&ImageId| {
                        context.scope.is_variable(**image) && !self.constant_poses.contains(image)
                    };
                    let is_fixed = !composed_images_of_frame().any(|image| is_variable(&image));
                    if is_fixed {
                        variables.problem_mut().fix(key);
                    }
                    variables.rig_poses.push((key, is_fixed));
                    key
                }
                (None, None) => continue,
            };
            self.rig_from_world[index] = Some(rig_from_world);
            for &image in composed_images_of_frame() {
                let Some((sensor, pose)) = self.sensor_of(frame, image) else { continue };
                let key =
                    *self.cam_from_rig.entry((frame.rig.index(), sensor)).or_insert_with(|| {
                        let key =
                            variables.problem_mut().add_parameter(pose, EliminationOrder::Last);
                        if is_constant || undetermined.contains(&(frame.rig.index(), sensor)) {
                            variables.problem_mut().fix(key);
                        }
                        key
                    });
                variables.compose_pose(image, key, rig_from_world);
            }
        }
        Ok(())
    }

    fn read(&mut self, problem: &Problem) {
        for (frame, key) in self.frames.iter_mut().zip(&self.rig_from_world) {
            if let Some(key) = key {
                frame.rig_from_world = problem.get(*key);
            }
        }
        for (&(rig, sensor), key) in &self.cam_from_rig {
            self.rigs[rig].sensors[sensor].cam_from_rig = Some(problem.get(*key));
        }
    }
}
