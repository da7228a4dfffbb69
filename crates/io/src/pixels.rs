//! Pixels in memory, however they were stored.

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom, Write};
use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::metadata::Orientation;
use image::{DynamicImage, ImageFormat, ImageReader};

use crate::exif::Exif;
use crate::jpeg::{self, Planes};
use crate::{AtomicFile, Error, Result};

/// Images of more pixels are refused where nobody says otherwise: 256 million. A file of a few
/// kilobytes can claim any size, and decoding takes some ten bytes a pixel. Above the largest
/// sensors in cameras that are sold in shops: 151 million pixels in medium format (Phase One IQ4,
/// 14,204 × 10,652), 200 million in phones (Samsung ISOCELL HP2, 16,320 × 12,240). Mosaics and
/// aerial cameras go beyond.
pub const MAX_PIXELS: u64 = 256_000_000;
/// Nobody can ask for more: here a decoder takes ten gigabytes, and four bytes a pixel still fit 32
/// bits.
pub const MOST_PIXELS: u64 = 1_000_000_000;
/// Deflate, which PNG uses, makes at most 1032 bytes of one: 258 bytes of two bits.
const MAX_DEFLATE_RATIO: u64 = 1032;
/// Bytes that a file may have for each pixel: four channels of 32 bits, as TIFF has them. And what
/// may lie beside: previews, and the seconds of video that phones append.
const MAX_BYTES_PER_PIXEL: u64 = 16;
const MAX_BYTES_BESIDE: u64 = 64 << 20;
const MILLION: u64 = 1_000_000;
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
    /// Reads an image file, turned as its EXIF orientation says. Colours become grey by the weights
    /// of ITU-R BT.709, as in COLMAP; JPEG's own luma (BT.601) would come without the colours, 16
    /// ms sooner for 6 megapixels, but gives fewer keypoints (on sceaux 116,214 instead of
    /// 119,074). 16 bits become 8; transparency is ignored.
    ///
    /// # Errors
    ///
    /// The file cannot be read, is no image, or one of more than [`MAX_PIXELS`].
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_within(path, &Allowed::Pixels(MAX_PIXELS))
    }

    pub(crate) fn read_within(path: &Path, allowed: &Allowed) -> Result<Self> {
        let (width, height, data) = match decode(path, Planes::Luma, allowed)? {
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
    ///
    /// # Errors
    ///
    /// The file cannot be read, is no image, or one of more than [`MAX_PIXELS`].
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_within(path, &Allowed::Pixels(MAX_PIXELS))
    }

    /// Reads an image of `width` × `height` pixels, however many that are.
    ///
    /// # Errors
    ///
    /// The file cannot be read, is no image, or one of another size.
    pub fn read_of_size(path: &Path, width: u32, height: u32) -> Result<Self> {
        Self::read_within(
            path,
            &Allowed::Size { width, height, what: "the photo", of: "the camera of its model" },
        )
    }

    pub(crate) fn read_within(path: &Path, allowed: &Allowed) -> Result<Self> {
        let image = decode(path, Planes::Rgb, allowed)?.into_rgb8();
        Ok(Self { width: image.width(), height: image.height(), data: image.into_raw() })
    }

    /// Writes an image file: JPEG (of quality 95), PNG or TIFF, as its name says. The folder must
    /// exist.
    pub fn write(&self, path: &Path) -> Result<()> {
        let format = ImageFormat::from_path(path)
            .map_err(|cause| Error::content(path, cause.to_string()))?;
        let mut bytes = Cursor::new(Vec::new());
        let color = image::ExtendedColorType::Rgb8;
        let (data, width, height) = (&self.data, self.width, self.height);
        let written = match format {
            ImageFormat::Jpeg => JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
                .encode(data, width, height, color),
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
    ((13_933 * u32::from(*r) + 46_871 * u32::from(*g) + 4_732 * u32::from(*b) + (1 << 15)) >> 16)
        as u8
}

/// Which sizes are decoded.
pub(crate) enum Allowed<'a> {
    /// Any with so many pixels.
    Pixels(u64),
    /// This one, as it is seen.
    Size { width: u32, height: u32, what: &'a str, of: &'a str },
}

impl Allowed<'_> {
    /// Whether an image of this size, as it is seen, may be decoded; if not, why.
    pub(crate) fn check(&self, width: u32, height: u32) -> Result<(), String> {
        let pixels = u64::from(width) * u64::from(height);
        match *self {
            _ if pixels == 0 => Err(format!("has {width} × {height} pixels")),
            Self::Size { width: w, height: h, what, of } if (w, h) != (width, height) => {
                Err(format!("{what} has {width} × {height} pixels, {of} has {w} × {h}"))
            }
            _ if pixels > MOST_PIXELS => {
                let most = MOST_PIXELS / MILLION;
                Err(format!(
                    "claims {width} × {height} pixels, and more than {most} million are never \
                    read: make it smaller"
                ))
            }
            Self::Pixels(most) if pixels > most => Err(format!(
                "claims {width} × {height} pixels, more than {} million: if it is a photo, give \
                --max-megapixels {}",
                most / MILLION,
                pixels.div_ceil(MILLION)
            )),
            _ => Ok(()),
        }
    }
}

/// Size of an image as it is seen, that is, turned by its EXIF orientation; from its header alone.
pub(crate) fn dimensions(
    path: &Path,
    exif: &Exif,
    stored: (u32, u32),
    allowed: &Allowed,
) -> Result<(u32, u32)> {
    let (width, height) = if exif.orientation >= 5 { (stored.1, stored.0) } else { stored };
    allowed.check(width, height).map_err(|what| Error::content(path, what))?;
    Ok((width, height))
}

/// Size of an image as it is stored, from its header alone: one that the length of the file can
/// hold.
pub(crate) fn stored_size(path: &Path) -> Result<(u32, u32)> {
    let content = |what: String| Error::content(path, what);
    let file = File::open(path).map_err(Error::io(path))?;
    let length = file.metadata().map_err(Error::io(path))?.len();
    if length == 0 {
        return Err(Error::content(path, "is empty"));
    }
    // By content, whatever the name.
    let reader =
        ImageReader::new(BufReader::new(file)).with_guessed_format().map_err(Error::io(path))?;
    let format = reader.format().ok_or_else(|| no_image(path))?;
    let (width, height, min_bytes) = if format == ImageFormat::Jpeg {
        let frame = jpeg::frame(&mut reader.into_inner());
        let frame = frame
            .ok_or_else(|| content("the JPEG data has no header, or is truncated".to_owned()))?;
        (frame.width, frame.height, frame.min_bytes)
    } else {
        let (width, height) =
            reader.into_dimensions().map_err(|cause| content(cause.to_string()))?;
        // Strips of a TIFF file may be the same bytes.
        let is_png = format == ImageFormat::Png;
        let min_bytes =
            if is_png { png_bytes(path, width, height)? / MAX_DEFLATE_RATIO } else { 0 };
        (width, height, min_bytes)
    };
    if length < min_bytes {
        return Err(content(format!(
            "claims {width} × {height} pixels, which take {min_bytes} bytes at least, but it has \
            {length}: it is damaged"
        )));
    }
    let most_bytes = MAX_BYTES_BESIDE + MAX_BYTES_PER_PIXEL * u64::from(width) * u64::from(height);
    if length > most_bytes {
        return Err(content(format!(
            "has {length} bytes, far too many for {width} × {height} pixels"
        )));
    }
    Ok((width, height))
}

/// Bytes of the rows of a PNG file before compression.
fn png_bytes(path: &Path, width: u32, height: u32) -> Result<u64> {
    // Behind signature, length, name, width and height.
    const DEPTH_OFFSET: u64 = 8 + 4 + 4 + 4 + 4;
    let mut kind = [0; 2];
    let mut file = File::open(path).map_err(Error::io(path))?;
    file.seek(SeekFrom::Start(DEPTH_OFFSET))
        .and_then(|_| file.read_exact(&mut kind))
        .map_err(Error::io(path))?;
    let [depth, color] = kind;
    let channels = match color {
        2 => 3,
        4 => 2,
        6 => 4,
        _ => 1,
    };
    let bits = u64::from(width) * u64::from(depth) * channels;
    Ok(u64::from(height) * (1 + bits.div_ceil(8)))
}

fn no_image(path: &Path) -> Error {
    Error::content(path, "is no JPEG, PNG or TIFF image")
}

fn decode(path: &Path, planes: Planes, allowed: &Allowed) -> Result<DynamicImage> {
    // By its header, before anything is read whole; how it is turned does not matter to its memory.
    let (width, height) = stored_size(path)?;
    let either =
        allowed.check(width, height).or_else(|what| allowed.check(height, width).map_err(|_| what));
    either.map_err(|what| Error::content(path, what))?;
    let bytes = std::fs::read(path).map_err(Error::io(path))?;
    let exif = Exif::from_bytes(&bytes);
    dimensions(path, &exif, (width, height), allowed)?;
    let mut image = match image::guess_format(&bytes) {
        Ok(ImageFormat::Jpeg) => {
            let decoded =
                jpeg::decode(&bytes, planes).map_err(|what| Error::content(path, what))?;
            let (w, h) = (decoded.width, decoded.height);
            let image = match decoded.planes {
                Planes::Luma => {
                    image::GrayImage::from_raw(w, h, decoded.bytes).map(DynamicImage::from)
                }
                Planes::Rgb => {
                    image::RgbImage::from_raw(w, h, decoded.bytes).map(DynamicImage::from)
                }
            };
            image.ok_or_else(|| {
                Error::content(path, "the JPEG data has another size than its header")
            })?
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
    image.apply_orientation(
        Orientation::from_exif(exif.orientation).unwrap_or(Orientation::NoTransforms),
    );
    Ok(image)
}
