//! Options of a feature-level scene.

/// Options of a feature-level scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeatureOptions {
    /// The seed of all random numbers.
    pub seed: u64,
    /// Approximate number of observations in tracks, over all images.
    pub observations: usize,
    /// Standard deviation of the noise of a keypoint of scale 2 px, along each axis, in pixels;
    /// proportional to the square root of the scale.
    pub noise_px: f64,
    /// Probability that an image detects a visible feature.
    pub detection: f64,
    /// Largest distance of an observed feature, in metres.
    pub max_range_m: f64,
    /// Largest angle between the viewing directions of a feature with matching descriptors, in
    /// radians.
    pub max_view_angle_rad: f64,
    /// Number of keypoints of each image without a track.
    pub clutter: usize,
    /// Number of visually aliased image pairs: consistent matches with a wrong geometry.
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
