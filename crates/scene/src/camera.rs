use tiepoint_geometry::Intrinsics;

/// A lens with its sensor; every image that it took shares its intrinsics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Model and parameters, in pixels.
    pub intrinsics: Intrinsics,
    /// Width of its images, in pixels.
    pub width: u32,
    /// Height of its images, in pixels.
    pub height: u32,
    /// Whether the focal length is known from somewhere (given, or EXIF) rather than guessed.
    pub has_focal_prior: bool,
}

impl Camera {
    /// Whether a pixel lies on the sensor.
    pub fn contains(&self, pixel: &tiepoint_geometry::nalgebra::Vector2<f64>) -> bool {
        (0.0..=f64::from(self.width)).contains(&pixel.x)
            && (0.0..=f64::from(self.height)).contains(&pixel.y)
    }
}
