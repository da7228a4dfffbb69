use std::path::PathBuf;

use tiepoint_sfm::geometry::OptionError;

/// Options of dense reconstruction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DenseOptions {
    /// Largest width and height of the undistorted images and depth maps, in pixels.
    pub max_image_size: Option<u32>,
    /// Number of source images of each depth map.
    pub sources: usize,
    /// Folder with a mask for each photo; pixels where a mask is 0 get no depth.
    pub masks: Option<PathBuf>,
    /// Whether to write normal maps, which COLMAP's fusion reads.
    pub write_normal_maps: bool,
    /// Whether to write the depth maps also as PNG of 16 bits, with one scale for all.
    pub write_depth_pngs: bool,
}

impl DenseOptions {
    /// Checks the ranges.
    ///
    /// # Errors
    ///
    /// Names the first option that is out of range.
    pub fn validate(&self) -> Result<(), OptionError> {
        if let Some(size) = self.max_image_size {
            OptionError::check("max_image_size", size.into(), size >= 1, "at least 1")?;
        }
        let sources = self.sources;
        OptionError::check("sources", sources as f64, sources >= 1, "at least 1")
    }
}

impl Default for DenseOptions {
    fn default() -> Self {
        Self {
            max_image_size: None,
            // 5 sources lower F1 by 1 to 3 % and take a quarter less CPU time
            // (`docs/benchmarks/dense.md`).
            sources: 8,
            masks: None,
            write_normal_maps: false,
            write_depth_pngs: false,
        }
    }
}
