use tiepoint_geometry::nalgebra::Vector3;

use crate::ImageId;

/// A keypoint of an image that sees a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Observation {
    /// Which image.
    pub image: ImageId,
    /// Which of its keypoints.
    pub keypoint: u32,
}

/// A point of the cloud and who sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// Where.
    pub xyz: Vector3<f64>,
    /// Red, green, blue.
    pub color: [u8; 3],
    /// Who sees it.
    pub observations: Vec<Observation>,
    /// Left out of adjustment, so that its reprojection error judges the model from outside.
    pub is_held_out: bool,
}

impl Track {
    /// A point with its observations; grey, not held out.
    pub fn new(xyz: Vector3<f64>, observations: Vec<Observation>) -> Self {
        Self { xyz, color: [128; 3], observations, is_held_out: false }
    }
}
