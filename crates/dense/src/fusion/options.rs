/// Options of [`fuse`](super::fuse).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionOptions {
    /// Smallest number of images that agree on a point, the reference included.
    pub min_views: usize,
    /// Largest distance between a pixel and the reprojection of the surface that another image
    /// sees there, in pixels. COLMAP's default is 2. With 2 and with 0.5, F1 at two footprints
    /// changes by at most 0.1 % on two made scenes.
    pub max_error_px: f64,
    /// Largest difference of two depths, relative; COLMAP's default.
    pub max_depth_error: f64,
    /// Largest angle between two normals, in radians. The default is three times COLMAP's: normals
    /// are those of a few pixels of a depth map, and noisier than estimated ones. With half and
    /// twice of it, F1 at two footprints is 86.9 and 87.5 % instead of 88.0 %, 84.4 and 84.2 %
    /// instead of 84.3 %.
    pub max_normal_error_rad: f64,
    /// Images in memory at a time.
    pub max_images_in_memory: usize,
}

impl Default for FusionOptions {
    fn default() -> Self {
        Self {
            min_views: 3,
            max_error_px: 1.0,
            max_depth_error: 0.01,
            max_normal_error_rad: 30f64.to_radians(),
            max_images_in_memory: 10,
        }
    }
}
