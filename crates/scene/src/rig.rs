//! Rigs of rigidly connected cameras, and frames of images from one instant (COLMAP's concepts).

use tiepoint_geometry::Rigid3;

use crate::{CameraId, ImageId, RigId};

/// Tolerance between an image's pose and the pose composed of its frame and rig: in radians, and in
/// units of the model relative to one plus the norm of the translation. It is far above rounding
/// errors and far below any measurement error.
pub const FRAME_POSE_TOLERANCE: f64 = 1e-6;

/// A camera on a rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigSensor {
    /// The camera.
    pub camera: CameraId,
    /// Pose of the camera on the rig, if known. The pose of the reference sensor, which is the
    /// first one, is the identity or `None`.
    pub cam_from_rig: Option<Rigid3>,
}

/// Rigidly connected cameras. The first sensor is the reference. A single camera is a rig of one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rig {
    /// The sensors.
    pub sensors: Vec<RigSensor>,
}

impl Rig {
    /// The sensor with a camera, if it is on the rig.
    pub fn sensor(&self, camera: CameraId) -> Option<&RigSensor> {
        self.sensors.iter().find(|sensor| sensor.camera == camera)
    }

    /// Pose of a camera on the rig: identity for the reference sensor; `None` if the camera is not
    /// on the rig, or if its pose is unknown.
    pub fn cam_from_rig(&self, camera: CameraId) -> Option<Rigid3> {
        match self.sensors.first() {
            Some(reference) if reference.camera == camera => Some(Rigid3::identity()),
            _ => self.sensor(camera)?.cam_from_rig,
        }
    }
}

/// Images of one instant, rigidly connected.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The rig.
    pub rig: RigId,
    /// Pose of the rig.
    pub rig_from_world: Rigid3,
    /// The images, at most one of each camera. Their poses are composed of frame and rig.
    pub images: Vec<ImageId>,
}

impl Frame {
    /// Pose of the frame's image of a camera. `rig` must be the frame's rig. `None` if the camera
    /// is not on the rig, or if its pose is unknown.
    pub fn cam_from_world(&self, rig: &Rig, camera: CameraId) -> Option<Rigid3> {
        rig.cam_from_rig(camera).map(|cam_from_rig| cam_from_rig * self.rig_from_world)
    }
}

/// Whether two poses of an image are equal up to [`FRAME_POSE_TOLERANCE`].
pub fn is_same_pose(one: &Rigid3, other: &Rigid3) -> bool {
    let rotation_rad = one.rotation.angle_to(&other.rotation);
    let translation = (one.translation - other.translation).norm();
    rotation_rad <= FRAME_POSE_TOLERANCE
        && translation <= FRAME_POSE_TOLERANCE * (1.0 + one.translation.norm())
}

/// Images that the cameras of a rig took at one instant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KnownFrame {
    /// The rig: an index of [`crate::KnownRigs::rigs`].
    pub rig: RigId,
    /// The images, at most one of each camera of the rig.
    pub images: Vec<ImageId>,
}
