use tiepoint_ba::{Key, Problem};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{CameraId, ImageId, PointId, Reconstruction};

/// A least-squares problem, and which of its variables is what.
pub struct Variables {
    problem: Problem,
    pub(super) cameras: Vec<(CameraId, ReadCamera)>,
    pub(super) poses: Vec<(ImageId, Key<Rigid3>)>,
    pub(super) composed: Vec<(ImageId, Composed)>,
    /// Poses of a rig at moments of which no image has a pose of its own, and whether they are
    /// held.
    pub(super) rig_poses: Vec<(Key<Rigid3>, bool)>,
    pub(super) points: Vec<(PointId, Key<Vector3<f64>>)>,
}

/// The pose of an image as a product of two variables.
#[derive(Clone, Copy)]
pub(super) struct Composed {
    pub(super) cam_from_rig: Key<Rigid3>,
    pub(super) rig_from_world: Key<Rigid3>,
}

/// Reads the intrinsics of one camera out of the solved problem; its parameter block has a type of
/// its own.
type ReadCamera = Box<dyn Fn(&Problem) -> Vec<f64>>;

impl Variables {
    pub(super) fn new() -> Self {
        Self {
            problem: Problem::new(),
            cameras: Vec::new(),
            poses: Vec::new(),
            composed: Vec::new(),
            rig_poses: Vec::new(),
            points: Vec::new(),
        }
    }

    /// The problem, to read.
    pub fn problem(&self) -> &Problem {
        &self.problem
    }

    /// The problem, to add variables and factors to.
    pub fn problem_mut(&mut self) -> &mut Problem {
        &mut self.problem
    }

    /// The images whose pose (`cam_from_world`) is a variable of its own, in order of their ids.
    pub fn poses(&self) -> &[(ImageId, Key<Rigid3>)] {
        &self.poses
    }

    /// Lets an image of [`super::Term::composed_images`] see its points from cam_from_rig ·
    /// rig_from_world.
    pub fn compose_pose(
        &mut self,
        image: ImageId,
        cam_from_rig: Key<Rigid3>,
        rig_from_world: Key<Rigid3>,
    ) {
        self.composed.push((image, Composed { cam_from_rig, rig_from_world }));
    }

    /// Changes the model to where the problem ended.
    pub(super) fn write_back(&self, model: &mut Reconstruction) {
        for (camera, read) in &self.cameras {
            model.camera_mut(*camera).intrinsics.params_mut().copy_from_slice(&read(&self.problem));
        }
        for &(image, key) in &self.poses {
            model.register(image, self.problem.get(key));
        }
        for &(image, Composed { cam_from_rig, rig_from_world }) in &self.composed {
            model
                .register(image, self.problem.get(cam_from_rig) * self.problem.get(rig_from_world));
        }
        for &(point, key) in &self.points {
            if let Some(track) = model.track_mut(point) {
                track.xyz = self.problem.get(key);
            }
        }
    }
}
