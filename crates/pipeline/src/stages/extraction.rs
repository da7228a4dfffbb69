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

/// Extracts the features of a photo, where its mask is not 0. Of a photo with a larger side than
/// `max_size` pixels, they are those of a reduced copy, in pixels of the photo.
///
/// # Errors
///
/// The photo or its mask cannot be read, and those of [`extract_image`].
pub fn extract_photo(
    extractor: &dyn Extractor,
    photos: &ImageFolder,
    index: usize,
    max_size: Option<u32>,
) -> Result<Features, Error> {
    let (image, mask) = (photos.luma(index)?, photos.mask(index)?);
    let reduced = max_size.and_then(|most| reduced_size(image.width, image.height, most));
    let Some((width, height)) = reduced else {
        return extract_image(extractor, &image, mask.as_ref());
    };
    let small = image.resized(width, height);
    let mask = mask.map(|mask| mask.resized(width, height));
    let mut features = extract_image(extractor, &small, mask.as_ref())?;
    let x = image.width as f32 / width as f32;
    let y = image.height as f32 / height as f32;
    for keypoint in &mut features.keypoints {
        keypoint.x *= x;
        keypoint.y *= y;
        keypoint.scale *= 0.5 * (x + y);
    }
    Ok(features)
}

/// The size of an image with its larger side reduced to `most`; `None` if it is smaller.
fn reduced_size(width: u32, height: u32, most: u32) -> Option<(u32, u32)> {
    let longest = width.max(height);
    if longest <= most {
        return None;
    }
    let scaled = |side: u32| {
        let side = f64::from(side) * f64::from(most) / f64::from(longest);
        (side.round() as u32).max(1)
    };
    Some((scaled(width), scaled(height)))
}

fn view(image: &Luma) -> GrayView<'_> {
    GrayView::new(&image.data, image.width as usize, image.height as usize)
}
