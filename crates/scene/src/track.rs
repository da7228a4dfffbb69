use tiepoint_geometry::nalgebra::Vector3;

use crate::ImageId;

/// A keypoint of an image that observes a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Observation {
    /// The image.
    pub image: ImageId,
    /// Index of the keypoint.
    pub keypoint: u32,
}

/// A 3D point with its observations.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// Position in the world frame.
    pub xyz: Vector3<f64>,
    /// Red, green, blue.
    pub color: [u8; 3],
    /// The observations.
    pub observations: Vec<Observation>,
    /// Whether the track takes no part in adjustment, so that its reprojection error is an
    /// independent test.
    pub is_held_out: bool,
}

impl Track {
    /// A grey point that is not held out.
    pub fn new(xyz: Vector3<f64>, observations: Vec<Observation>) -> Self {
        Self { xyz, color: [128; 3], observations, is_held_out: false }
    }
}
