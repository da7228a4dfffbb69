//! Options of a feature-level scene: keypoints and tracks without rendered images.

/// Options of a feature-level scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeatureOptions {
    /// The seed of all random numbers.
    pub seed: u64,
    /// Approximate number of observations of points, over all images together.
    pub observations: usize,
    /// Standard deviation of the noise of a keypoint of scale 2 px, along each axis, in pixels;
    /// proportional to the square root of the scale.
    pub noise_px: f64,
    /// Probability that an image detects a visible point.
    pub detection: f64,
    /// Largest distance between a point and a camera that observes it, in metres.
    pub max_range_m: f64,
    /// Largest angle, in radians, between the direction from a point to the image that it was drawn
    /// in and the direction to another image that observes it. Descriptors do not match beyond it.
    pub max_view_angle_rad: f64,
    /// Number of keypoints in each image that belong to no point.
    pub clutter: usize,
    /// Number of image pairs of different places that look alike: their matches agree with one
    /// relative pose, which is wrong.
    pub wrong_pairs: usize,
}

impl Default for FeatureOptions {
    fn default() -> Self {
        Self {
            seed: 1,
            observations: 50_000,
            noise_px: 0.5,
            detection: 0.7,
            max_range_m: 60.0,
            max_view_angle_rad: 35f64.to_radians(),
            clutter: 50,
            wrong_pairs: 0,
        }
    }
}
