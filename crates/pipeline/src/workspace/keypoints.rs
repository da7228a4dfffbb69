use tiepoint_sfm::geometry::nalgebra::Vector2;
use tiepoint_sfm::scene::Keypoint;

/// Converts a keypoint of the detector to one of the scene.
pub(crate) fn keypoint(keypoint: &tiepoint_io::features::Keypoint) -> Keypoint {
    Keypoint {
        pixel: Vector2::new(f64::from(keypoint.x), f64::from(keypoint.y)),
        scale_px: keypoint.scale,
    }
}
