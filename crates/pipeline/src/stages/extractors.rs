//! Feature extraction in parallel.

use std::sync::{Mutex, MutexGuard, PoisonError};

use tiepoint_input::{ImageFolder, ImageInfo, Luma};
use tiepoint_io::features::{self as sift, Features, GrayView, Sift};

use crate::Error;

/// Memory of feature extraction, in bytes per pixel.
const BYTES_PER_PIXEL: u64 = 16;

/// Memory of the extraction of a photo, in bytes.
pub fn memory_of(photo: &ImageInfo) -> u64 {
    BYTES_PER_PIXEL * u64::from(photo.width) * u64::from(photo.height)
}

/// Pool of extractors, whose buffers are reused: one per image that is processed at a time.
pub struct Extractors {
    options: sift::Options,
    idle: Mutex<Vec<Sift>>,
}

impl Extractors {
    /// A pool without extractors.
    pub fn new(options: sift::Options) -> Self {
        Self { options, idle: Mutex::default() }
    }

    /// Extracts the features of an image, where its mask is not 0.
    ///
    /// # Errors
    ///
    /// The image is too small or too large for the detector.
    pub fn extract(&self, image: &Luma, mask: Option<&Luma>) -> Result<Features, Error> {
        let idle = self.idle().pop();
        let mut sift = idle.map_or_else(|| Sift::new(self.options), Ok)?;
        let features = sift.extract(&view(image), mask.map(view).as_ref())?;
        self.idle().push(sift);
        Ok(features)
    }

    /// Extracts the features of a photo, where its mask is not 0.
    ///
    /// # Errors
    ///
    /// The photo or its mask cannot be read, and those of [`Extractors::extract`].
    pub fn extract_photo(&self, photos: &ImageFolder, index: usize) -> Result<Features, Error> {
        let (image, mask) = (photos.luma(index)?, photos.mask(index)?);
        self.extract(&image, mask.as_ref())
    }

    fn idle(&self) -> MutexGuard<'_, Vec<Sift>> {
        // The list stays valid when a thread panics while it holds the lock.
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn view(image: &Luma) -> GrayView<'_> {
    GrayView::new(&image.data, image.width as usize, image.height as usize)
}
