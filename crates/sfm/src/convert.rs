//! Keypoints and matches of the crates `features` and `matching` as those of a scene.

use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_matching::features;
use tiepoint_scene::{Keypoint, Match};

/// The keypoint of a scene: position and scale, without the orientation.
pub fn keypoint(keypoint: &features::Keypoint) -> Keypoint {
    let pixel = Vector2::new(f64::from(keypoint.x), f64::from(keypoint.y));
    Keypoint { pixel, scale_px: keypoint.scale }
}

/// The match of a scene, without the distance of the descriptors.
pub fn matched(found: &tiepoint_matching::Match) -> Match {
    Match { a: found.a, b: found.b }
}
