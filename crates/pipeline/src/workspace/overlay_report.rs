//! What stands still in images, for the report.

use serde::{Deserialize, Serialize};

/// What stands still in the images of a camera while the scene moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct OverlayReport {
    /// COLMAP's id of the camera; none for images of one size that each have their own camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<u32>,
    /// Image width, in pixels.
    pub width: u32,
    /// Image height, in pixels.
    pub height: u32,
    /// Number of images with it.
    pub images: usize,
    /// Number of spots with a keypoint that stands still.
    pub spots: usize,
    /// Where they are: left, top, right and bottom in pixels, the region with most spots first.
    pub regions: Vec<[f64; 4]>,
}
