//! The result of feature extraction.

use crate::Descriptors;

/// A keypoint in pixels of the original image; the centre of the top-left pixel is (0.5, 0.5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Column, in pixels.
    pub x: f32,
    /// Row, in pixels.
    pub y: f32,
    /// Scale: the standard deviation σ of the Gaussian of the extremum, in pixels of the original
    /// image. Detectors without a scale give 1, as COLMAP does: all keypoints then have the same
    /// standard deviation in a bundle adjustment.
    pub scale: f32,
    /// Dominant gradient direction in radians, from +x towards +y (clockwise as seen on the image),
    /// in (-π, π]. Detectors without one give 0.
    pub orientation: f32,
}

/// The features of an image. Descriptor `i` belongs to `keypoints[i]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// The keypoints. Detectors sort them by importance, the most repeatable first: image retrieval
    /// uses the leading ones.
    pub keypoints: Vec<Keypoint>,
    /// The descriptors.
    pub descriptors: Descriptors,
}
