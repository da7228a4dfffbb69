//! The result of feature extraction.

/// A keypoint in pixels of the original image; the centre of the top-left pixel is (0.5, 0.5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Column, in pixels.
    pub x: f32,
    /// Row, in pixels.
    pub y: f32,
    /// Scale: the standard deviation σ of the Gaussian of the extremum, in pixels of the original
    /// image.
    pub scale: f32,
    /// Dominant gradient direction in radians, from +x towards +y (clockwise as seen on the image),
    /// in (-π, π].
    pub orientation: f32,
}

/// A 128-dimensional descriptor: 4 × 4 cells of 8 gradient directions, cells row-major, directions
/// of a cell contiguous.
pub type Descriptor = [u8; 128];

/// The features of an image. `descriptors[i]` belongs to `keypoints[i]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// The keypoints.
    pub keypoints: Vec<Keypoint>,
    /// The descriptors.
    pub descriptors: Vec<Descriptor>,
}
