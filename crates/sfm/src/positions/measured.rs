use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_scene::ImageId;

/// The measured centre of an image's camera, in a metric frame with z up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredPosition {
    /// The image.
    pub image: ImageId,
    /// Its measured centre.
    pub xyz: Vector3<f64>,
    /// Whether its height is measured; else z is arbitrary.
    pub has_height: bool,
    /// Standard deviations along x and y, and along z, in metres; `None` if they are not known.
    pub sigmas_m: Option<[f64; 2]>,
}
