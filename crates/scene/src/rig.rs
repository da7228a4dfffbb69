use tiepoint_geometry::Rigid3;

use crate::{CameraId, ImageId, RigId};

/// A camera's place on a rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigSensor {
    /// Which camera.
    pub camera: CameraId,
    /// Its pose on the rig, once known; identity for the reference, which is the first sensor.
    pub cam_from_rig: Option<Rigid3>,
}

/// Cameras that ride together; the first sensor is the reference. A lone camera is a rig of one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rig {
    /// Its cameras.
    pub sensors: Vec<RigSensor>,
}

/// The images of one moment, rigidly connected.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Which rig took them.
    pub rig: RigId,
    /// Pose of the rig.
    pub rig_from_world: Rigid3,
    /// Its images, one a camera at most.
    pub images: Vec<ImageId>,
}
