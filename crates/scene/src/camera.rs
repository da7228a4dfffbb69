use tiepoint_geometry::Intrinsics;

/// A camera: one set of intrinsics and an image size, shared by all its images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Camera model and parameters, in pixels.
    pub intrinsics: Intrinsics,
    /// Width of its images, in pixels.
    pub width: u32,
    /// Height of its images, in pixels.
    pub height: u32,
    /// Whether the focal length comes from the user or from EXIF, not from a guess.
    pub has_focal_prior: bool,
}

impl Camera {
    /// Whether the essential matrix of its images can be estimated: the focal length is known, or
    /// the model has none.
    pub fn is_calibrated(&self) -> bool {
        self.has_focal_prior || self.intrinsics.kind().focal_indices().is_empty()
    }

    /// Whether a pixel lies inside the image.
    pub fn contains(&self, pixel: &tiepoint_geometry::nalgebra::Vector2<f64>) -> bool {
        (0.0..=f64::from(self.width)).contains(&pixel.x)
            && (0.0..=f64::from(self.height)).contains(&pixel.y)
    }
}
