//! Pixels in memory, however they were stored.

use std::io::{Cursor, Write};
use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::metadata::Orientation;
use image::{DynamicImage, ImageFormat, ImageReader};

use crate::exif::Exif;
use crate::jpeg::{self, Planes};
use crate::{AtomicFile, Error, Result};

/// More pixels than this in one image are taken for a broken header: 2²⁹, half a gigabyte of luma.
const MAX_PIXELS: u64 = 1 << 29;
/// Little is lost beyond it, and files grow.
const JPEG_QUALITY: u8 = 95;

/// A grey image, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Luma {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// One byte a pixel.
    pub data: Vec<u8>,
}

/// A colour image, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Rgb {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Three bytes a pixel.
    pub data: Vec<u8>,
}

impl Luma {
    /// Reads an image file, turned as its EXIF orientation says. Colours become grey by the weights of ITU-R BT.709, as in
    /// COLMAP; JPEG's own luma (BT.601) would come without the colours, 16 ms sooner for 6 megapixels, but gives fewer keypoints
    /// (on sceaux 116,214 instead of 119,074). 16 bits become 8; transparency is ignored.
    pub fn read(path: &Path) -> Result<Self> {
        let (width, height, data) = match decode(path, Planes::Luma)? {
            DynamicImage::ImageLuma8(image) => (image.width(), image.height(), image.into_raw()),
            other => {
                let luma = other.to_rgb8().as_raw().as_chunks().0.iter().map(luma).collect();
                (other.width(), other.height(), luma)
            }
        };
        Ok(Self { width, height, data })
    }
}

impl Rgb {
    /// Reads an image file, turned as its EXIF orientation says.
    pub fn read(path: &Path) -> Result<Self> {
        let image = decode(path, Planes::Rgb)?.into_rgb8();
        Ok(Self { width: image.width(), height: image.height(), data: image.into_raw() })
    }

    /// Writes an image file: JPEG (of quality 95), PNG or TIFF, as its name says. The folder must exist.
    pub fn write(&self, path: &Path) -> Result<()> {
        let format = ImageFormat::from_path(path).map_err(|cause| Error::content(path, cause.to_string()))?;
        let mut bytes = Cursor::new(Vec::new());
        let color = image::ExtendedColorType::Rgb8;
        let (data, width, height) = (&self.data, self.width, self.height);
        let written = match format {
            ImageFormat::Jpeg => {
                JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY).encode(data, width, height, color)
            }
            _ => image::write_buffer_with_format(&mut bytes, data, width, height, color, format),
        };
        written.map_err(|cause| Error::content(path, cause.to_string()))?;
        AtomicFile::write_with(path, |file| file.write_all(bytes.get_ref()))
    }

    /// The colour of the pixel at column x, row y.
    pub fn pixel(&self, x: u32, y: u32) -> [u8; 3] {
        let start = 3 * (y as usize * self.width as usize + x as usize);
        [self.data[start], self.data[start + 1], self.data[start + 2]]
    }
}

/// 0.2126 R + 0.7152 G + 0.0722 B in sixteen bits of fraction, rounded.
fn luma([r, g, b]: &[u8; 3]) -> u8 {
    ((13_933 * u32::from(*r) + 46_871 * u32::from(*g) + 4_732 * u32::from(*b) + (1 << 15)) >> 16) as u8
}

/// Size of an image as it is seen, that is, turned by its EXIF orientation; from its header alone.
pub(crate) fn dimensions(path: &Path, exif: &Exif) -> Result<(u32, u32)> {
    // By content, whatever the name.
    let file = std::fs::File::open(path).map_err(Error::io(path))?;
    let reader =
        ImageReader::new(std::io::BufReader::new(file)).with_guessed_format().map_err(Error::io(path))?;
    let (width, height) = match reader.format() {
        Some(ImageFormat::Jpeg) => jpeg::dimensions(&mut reader.into_inner())
            .ok_or_else(|| Error::content(path, "the JPEG data has no header, or is truncated"))?,
        Some(_) => reader.into_dimensions().map_err(|cause| Error::content(path, cause.to_string()))?,
        None => return Err(no_image(path)),
    };
    check_size(path, width, height)?;
    Ok(if exif.orientation >= 5 { (height, width) } else { (width, height) })
}

fn no_image(path: &Path) -> Error {
    Error::content(path, "is no JPEG, PNG or TIFF image")
}

pub(crate) fn check_size(path: &Path, width: u32, height: u32) -> Result<()> {
    let pixels = u64::from(width) * u64::from(height);
    if pixels == 0 || pixels > MAX_PIXELS {
        return Err(Error::content(path, format!("{width} × {height} pixels are out of range")));
    }
    Ok(())
}

fn decode(path: &Path, planes: Planes) -> Result<DynamicImage> {
    let bytes = std::fs::read(path).map_err(Error::io(path))?;
    if bytes.is_empty() {
        return Err(Error::content(path, "is empty"));
    }
    let exif = Exif::from_bytes(&bytes);
    let (width, height) = dimensions(path, &Exif::default())?;
    let mut image = match image::guess_format(&bytes) {
        Ok(ImageFormat::Jpeg) => {
            let decoded = jpeg::decode(&bytes, planes).map_err(|what| Error::content(path, what))?;
            let (w, h) = (decoded.width, decoded.height);
            let image = match decoded.planes {
                Planes::Luma => image::GrayImage::from_raw(w, h, decoded.bytes).map(DynamicImage::from),
                Planes::Rgb => image::RgbImage::from_raw(w, h, decoded.bytes).map(DynamicImage::from),
            };
            image.ok_or_else(|| Error::content(path, "the JPEG data has another size than its header"))?
        }
        Ok(format) => {
            let mut reader = ImageReader::with_format(Cursor::new(&bytes), format);
            let mut limits = image::Limits::default();
            // Four channels of 16 bits.
            limits.max_alloc = Some(8 * u64::from(width) * u64::from(height) + (64 << 20));
            reader.limits(limits);
            reader.decode().map_err(|cause| Error::content(path, cause.to_string()))?
        }
        Err(_) => return Err(no_image(path)),
    };
    image.apply_orientation(Orientation::from_exif(exif.orientation).unwrap_or(Orientation::NoTransforms));
    Ok(image)
}
