//! Cameras that are rigidly connected, and the images that they took at the same moments.

use tiepoint_geometry::Rigid3;

use crate::{CameraId, ImageId, RigId};

/// How far an image's pose may be from the one that its frame and its rig give it: in radians, and
/// in the model's unit of length per one plus the length of the pose's translation. Far above
/// rounding, far below what anything can measure.
pub const FRAME_POSE_TOLERANCE: f64 = 1e-6;

/// A camera's place on a rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigSensor {
    /// Which camera.
    pub camera: CameraId,
    /// Its pose on the rig, once known; of the reference, which is the first sensor, identity or
    /// nothing.
    pub cam_from_rig: Option<Rigid3>,
}

/// Cameras that ride together; the first sensor is the reference. A lone camera is a rig of one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rig {
    /// Its cameras.
    pub sensors: Vec<RigSensor>,
}

impl Rig {
    /// The sensor that a camera is, where it is on the rig.
    pub fn sensor(&self, camera: CameraId) -> Option<&RigSensor> {
        self.sensors.iter().find(|sensor| sensor.camera == camera)
    }

    /// The pose of a camera on the rig: identity for the reference; `None` where the camera is not
    /// on the rig, or its pose is not known.
    pub fn cam_from_rig(&self, camera: CameraId) -> Option<Rigid3> {
        match self.sensors.first() {
            Some(reference) if reference.camera == camera => Some(Rigid3::identity()),
            _ => self.sensor(camera)?.cam_from_rig,
        }
    }
}

/// The images of one moment, rigidly connected.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Which rig took them.
    pub rig: RigId,
    /// Pose of the rig.
    pub rig_from_world: Rigid3,
    /// Its images, one a camera at most. Their poses are those that frame and rig give them.
    pub images: Vec<ImageId>,
}

impl Frame {
    /// The pose that the frame gives to its image of a camera on `rig`, the frame's rig; `None`
    /// where the camera is not on the rig, or its pose there is not known.
    pub fn cam_from_world(&self, rig: &Rig, camera: CameraId) -> Option<Rigid3> {
        rig.cam_from_rig(camera).map(|cam_from_rig| cam_from_rig * self.rig_from_world)
    }
}

/// Whether two poses of an image are the same up to [`FRAME_POSE_TOLERANCE`].
pub fn is_same_pose(one: &Rigid3, other: &Rigid3) -> bool {
    let rotation_rad = one.rotation.angle_to(&other.rotation);
    let translation = (one.translation - other.translation).norm();
    rotation_rad <= FRAME_POSE_TOLERANCE
        && translation <= FRAME_POSE_TOLERANCE * (1.0 + one.translation.norm())
}
