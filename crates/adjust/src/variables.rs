use std::collections::BTreeMap;

use tiepoint_ba::{AnyKey, FactorKey, Key, Problem};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::{CameraId, ImageId, PointId, Reconstruction};

/// A least-squares problem, with the keys of its variables.
pub struct Variables {
    problem: Problem,
    pub(crate) cameras: Vec<(CameraId, AnyKey, ReadCamera)>,
    pub(crate) poses: Vec<(ImageId, Key<Rigid3>)>,
    pub(crate) composed: Vec<(ImageId, ComposedPose)>,
    /// Poses of frames without a pose variable of an image, and whether they are constant.
    pub(crate) rig_poses: Vec<(Key<Rigid3>, bool)>,
    pub(crate) points: Vec<(PointId, Key<Vector3<f64>>)>,
    /// In the order of their factors.
    pub(crate) observations: Vec<ObservationFactor>,
}

/// A reprojection error.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ObservationFactor {
    pub(crate) factor: FactorKey,
    pub(crate) image: ImageId,
    pub(crate) keypoint: u32,
}

/// The pose of an image as a product of two variables, `cam_from_rig` · `rig_from_world`.
#[derive(Clone, Copy, Debug)]
pub struct ComposedPose {
    /// Pose of the camera on the rig.
    pub cam_from_rig: Key<Rigid3>,
    /// Pose of the frame, or of the image of the reference sensor.
    pub rig_from_world: Key<Rigid3>,
}

/// Reads the intrinsics of a camera from the solved problem. The type of the parameter block
/// depends on the camera model.
pub(crate) type ReadCamera = Box<dyn Fn(&Problem) -> Vec<f64>>;

impl Variables {
    pub(crate) fn new() -> Self {
        Self {
            problem: Problem::new(),
            cameras: Vec::new(),
            poses: Vec::new(),
            composed: Vec::new(),
            rig_poses: Vec::new(),
            points: Vec::new(),
            observations: Vec::new(),
        }
    }

    /// The problem.
    pub fn problem(&self) -> &Problem {
        &self.problem
    }

    /// The problem, for adding variables and factors.
    pub fn problem_mut(&mut self) -> &mut Problem {
        &mut self.problem
    }

    /// The images whose pose (`cam_from_world`) is a variable, in order of their ids.
    pub fn poses(&self) -> &[(ImageId, Key<Rigid3>)] {
        &self.poses
    }

    /// The images whose pose is composed of variables, as far as the terms have composed it: those
    /// of the model's frames first, then those of each term in turn.
    pub fn composed_poses(&self) -> &[(ImageId, ComposedPose)] {
        &self.composed
    }

    /// The cameras that take part, with the keys of their intrinsics.
    pub fn intrinsics(&self) -> impl Iterator<Item = (CameraId, AnyKey)> {
        self.cameras.iter().map(|(camera, key, _)| (*camera, *key))
    }

    /// The points that take part, in order of their ids: neither held-out ones nor, with
    /// [`crate::AdjustOptions::select_tracks`], those that were not selected.
    pub fn points(&self) -> &[(PointId, Key<Vector3<f64>>)] {
        &self.points
    }

    /// Composes the pose of an image of [`crate::Term::composed_images`] as `cam_from_rig` ·
    /// `rig_from_world`.
    pub fn compose_pose(
        &mut self,
        image: ImageId,
        cam_from_rig: Key<Rigid3>,
        rig_from_world: Key<Rigid3>,
    ) {
        self.composed.push((image, ComposedPose { cam_from_rig, rig_from_world }));
    }

    /// Whether a frame has images of cameras with different centres on the rig, so that constant
    /// extrinsics determine the scale.
    pub(crate) fn have_baseline(&self) -> bool {
        let mut centres: BTreeMap<Key<Rigid3>, Vector3<f64>> =
            self.poses.iter().map(|(_, key)| (*key, Vector3::zeros())).collect();
        self.composed.iter().any(|(_, ComposedPose { cam_from_rig, rig_from_world })| {
            let centre = self.problem.get(*cam_from_rig).origin_in_a();
            let other = *centres.entry(*rig_from_world).or_insert(centre);
            (centre - other).norm() > f64::EPSILON * centre.norm()
        })
    }

    /// Copies the solution to the model.
    pub(crate) fn write_back(&self, model: &mut Reconstruction) {
        for (camera, _, read) in &self.cameras {
            model.camera_mut(*camera).intrinsics.params_mut().copy_from_slice(&read(&self.problem));
        }
        for &(image, key) in &self.poses {
            model.register(image, self.problem.get(key));
        }
        for &(image, ComposedPose { cam_from_rig, rig_from_world }) in &self.composed {
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
