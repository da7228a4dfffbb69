/// Options of dense reconstruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DenseOptions {
    /// Largest width and height of the undistorted images and depth maps, in pixels.
    pub max_image_size: Option<u32>,
    /// Number of source images of each depth map.
    pub sources: usize,
    /// Whether normal maps are written, which COLMAP's fusion reads.
    pub has_normal_maps: bool,
}

impl Default for DenseOptions {
    fn default() -> Self {
        Self { max_image_size: None, sources: 5, has_normal_maps: false }
    }
}
