//! What crosses from feature extraction to everything else.

/// A keypoint in pixels of the original image; the centre of the top-left pixel is (0.5, 0.5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Column, in pixels.
    pub x: f32,
    /// Row, in pixels.
    pub y: f32,
    /// Standard deviation of the Gaussian at which the keypoint was found, in pixels of the
    /// original image.
    pub scale: f32,
    /// Dominant gradient direction in radians, from +x towards +y (clockwise as seen on the image),
    /// in (-π, π].
    pub orientation: f32,
}

/// A 128-dimensional descriptor: 4 × 4 cells of 8 orientations, row-major, the orientation fastest.
pub type Descriptor = [u8; 128];

/// The keypoints of one image with their descriptors; both lists have the same length and order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// Where.
    pub keypoints: Vec<Keypoint>,
    /// What it looks like there.
    pub descriptors: Vec<Descriptor>,
}
