//! Extraction of the features of a photo.

use tiepoint_input::{ImageFolder, ImageInfo, Luma};
use tiepoint_io::features::{Extractor, Features, GrayView};

use crate::Error;

/// Memory of the extraction of a photo, in bytes.
pub fn memory_of(extractor: &dyn Extractor, photo: &ImageInfo) -> u64 {
    extractor.memory_bytes(photo.width, photo.height)
}

/// Extracts the features of an image, where its mask is not 0.
///
/// # Errors
///
/// The extractor fails, or does not give a descriptor of its format for each keypoint.
pub fn extract_image(
    extractor: &dyn Extractor,
    image: &Luma,
    mask: Option<&Luma>,
) -> Result<Features, Error> {
    let found = extractor.extract(&view(image), mask.map(view).as_ref()).map_err(Error::Method)?;
    let Features { keypoints, descriptors } = &found;
    if keypoints.len() != descriptors.len() || descriptors.format() != extractor.format() {
        return Err(Error::InvalidFeatures {
            extractor: extractor.name().to_owned(),
            keypoints: keypoints.len(),
            descriptors: descriptors.len(),
            format: descriptors.format(),
        });
    }
    Ok(found)
}

/// Extracts the features of a photo, where its mask is not 0.
///
/// # Errors
///
/// The photo or its mask cannot be read, and those of [`extract_image`].
pub fn extract_photo(
    extractor: &dyn Extractor,
    photos: &ImageFolder,
    index: usize,
) -> Result<Features, Error> {
    let (image, mask) = (photos.luma(index)?, photos.mask(index)?);
    extract_image(extractor, &image, mask.as_ref())
}

fn view(image: &Luma) -> GrayView<'_> {
    GrayView::new(&image.data, image.width as usize, image.height as usize)
}
