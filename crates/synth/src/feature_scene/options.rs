//! What a caller may choose of a scene of features.

/// What to see, and how well.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeatureOptions {
    /// Every random number follows from it.
    pub seed: u64,
    /// About so many observations in tracks, over all images.
    pub observations: usize,
    /// Standard deviation of a keypoint of scale 2 px, along each axis, in pixels; it goes with the
    /// root of the scale.
    pub noise_px: f64,
    /// Chance that an image detects a feature that it could.
    pub detection: f64,
    /// How far features are seen, in metres.
    pub max_range_m: f64,
    /// Largest angle between the directions from which a feature looks alike, in radians.
    pub max_view_angle_rad: f64,
    /// Keypoints of each image that nothing else corresponds to.
    pub clutter: usize,
    /// Pairs of images that look alike without seeing the same: consistent matches with a wrong
    /// geometry.
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
