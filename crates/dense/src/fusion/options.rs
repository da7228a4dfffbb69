/// Options of [`fuse`](super::fuse).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionOptions {
    /// Smallest number of images that agree on a point, the reference included. Where a point lies
    /// in fewer images, two suffice.
    pub min_views: usize,
    /// Largest distance between a pixel and the reprojection of the surface that another image
    /// sees there, in pixels. COLMAP's default is 2. Half and twice of it change F1 by at most
    /// 0.1 % (`docs/benchmarks/dense.md`).
    pub max_error_px: f64,
    /// Largest difference of two depths, relative; COLMAP's default.
    pub max_depth_error: f64,
    /// Largest angle between two normals, in radians. The default is three times COLMAP's: normals
    /// are those of a few pixels of a depth map, and noisier than estimated ones. Half of it lowers
    /// F1 by up to 1.1 %, twice of it by up to 0.5 %.
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
