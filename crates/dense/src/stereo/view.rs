//! Images for stereo.

use crate::Grey;
use crate::pinhole::PosedPinhole;

/// Most source images of a reference image.
pub const MAX_SOURCES: usize = 8;

/// An image with its camera.
#[derive(Clone, Debug)]
pub struct StereoImage {
    /// The camera.
    pub camera: PosedPinhole,
    /// The image, of the size of the camera.
    pub grey: Grey,
}

impl StereoImage {
    pub(crate) fn halved(&self) -> Self {
        Self { camera: self.camera.halved(), grey: self.grey.halved() }
    }
}
