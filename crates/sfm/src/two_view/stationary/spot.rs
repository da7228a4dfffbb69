//! Spots of the image that stand still.

use std::collections::BTreeSet;

use tiepoint_geometry::nalgebra::Vector2;

/// A spot of the image.
#[derive(Debug)]
pub(super) struct Spot {
    /// Its keypoints, sorted.
    pub(super) keypoints: Vec<(u32, u32)>,
    /// Its images, sorted.
    pub(super) images: Vec<u32>,
    /// Mean position, in pixels.
    pub(super) pixel: Vector2<f64>,
    /// Mean scale, in pixels.
    pub(super) scale_px: f64,
    /// Whether it has any moving inlier match.
    pub(super) is_moved: bool,
    /// Whether it has so many that it is no overlay.
    pub(super) moves: bool,
}

/// The images of spots.
pub(super) fn images_of(spots: &[&Spot]) -> BTreeSet<u32> {
    spots.iter().flat_map(|spot| &spot.images).copied().collect()
}
