use tiepoint_geometry::OptionError;

/// Thresholds of registration.
#[derive(Clone, Copy, Debug)]
pub struct RegisterOptions {
    /// Maximum reprojection error of an inlier, in pixels.
    pub max_error_px: f64,
    /// Minimum number of inliers. The mapper takes images with half of it, if that is significant
    /// under random matches, when no other image is left.
    pub min_num_inliers: usize,
    /// Minimum fraction of inliers.
    pub min_inlier_ratio: f64,
}

impl RegisterOptions {
    /// Checks the ranges.
    ///
    /// # Errors
    ///
    /// Names the first option that is out of range.
    pub fn validate(&self) -> Result<(), OptionError> {
        OptionError::check_positive("register.max_error_px", self.max_error_px)?;
        let least = self.min_num_inliers;
        OptionError::check("register.min_num_inliers", least as f64, least >= 1, "at least 1")?;
        OptionError::check_ratio("register.min_inlier_ratio", self.min_inlier_ratio)
    }
}

impl Default for RegisterOptions {
    fn default() -> Self {
        Self { max_error_px: 12.0, min_num_inliers: 30, min_inlier_ratio: 0.25 }
    }
}
