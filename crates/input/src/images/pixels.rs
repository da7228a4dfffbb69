//! Decoded images, and the limits of their size.

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom, Write};
use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::imageops::FilterType;
use image::metadata::Orientation;
use image::{ColorType, DynamicImage, ExtendedColorType, ImageDecoder, ImageFormat, ImageReader};
use tiepoint_io::{Error, Result};
use tiepoint_store::AtomicFile;

use super::exif::Exif;
use super::jpeg::{self, Planes};
use super::tiff_pages;

/// Default limit: images of more than 256 million pixels are refused. A file of a few kilobytes can
/// claim any size, and decoding takes some ten bytes a pixel. The limit is above the largest
/// sensors of consumer cameras: 151 million pixels in medium format (Phase One IQ4, 14,204 ×
/// 10,652), 200 million in phones (Samsung ISOCELL HP2, 16,320 × 12,240). Mosaics and aerial
/// cameras exceed it.
pub const DEFAULT_MAX_PIXELS: u64 = 256_000_000;
/// Largest limit that a caller may set: a decoder takes ten gigabytes for such an image, and four
/// bytes a pixel still fit 32 bits.
pub const ABSOLUTE_MAX_PIXELS: u64 = 1_000_000_000;
/// Largest compression ratio of Deflate, which PNG uses: 258 bytes from two bits.
const MAX_DEFLATE_RATIO: u64 = 1032;
/// Largest size of a file: bytes per pixel (four channels of 32 bits, as TIFF has them), plus bytes
/// for other content (previews, and the seconds of video that phones append).
const MAX_BYTES_PER_PIXEL: u64 = 16;
const MAX_BYTES_BESIDE: u64 = 64 << 20;
const MILLION: u64 = 1_000_000;
/// Higher qualities preserve little more, and files grow.
const JPEG_QUALITY: u8 = 95;

/// A grey image, by rows from the top left.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Luma {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// One byte a pixel.
    pub data: Vec<u8>,
}

/// A colour image, by rows from the top left.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Rgb {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Three bytes a pixel.
    pub data: Vec<u8>,
}

impl Luma {
    /// Reads an image file, rotated as its EXIF orientation asks for. Grey is the luma of ITU-R
    /// BT.709, as in COLMAP. Decoding only the luma plane of JPEG (BT.601) would be 16 ms faster
    /// for 6 megapixels, but yields fewer keypoints (on sceaux 116,214 instead of 119,074). 16 bits
    /// are reduced to 8, as if all were used (an [`ImageFolder`](crate::ImageFolder) knows better);
    /// transparency is ignored ([`ImageFolder::mask`](crate::ImageFolder::mask)
    /// has it).
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is not an image, or has more than [`DEFAULT_MAX_PIXELS`].
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_within(path, &SizeLimit::Pixels(DEFAULT_MAX_PIXELS))
    }

    pub(crate) fn read_within(path: &Path, limit: &SizeLimit) -> Result<Self> {
        Self::read_turned(path, limit, Turn::Upright)
    }

    pub(crate) fn read_turned(path: &Path, limit: &SizeLimit, turn: Turn) -> Result<Self> {
        Self::read_ranged(path, limit, turn, || ALL_BITS)
    }

    /// Reads an image whose values have so many bits, if it has 16 bits a channel.
    pub(crate) fn read_ranged(
        path: &Path,
        limit: &SizeLimit,
        turn: Turn,
        bits: impl FnOnce() -> u32,
    ) -> Result<Self> {
        let image = decode(path, Planes::Luma, limit, turn)?;
        let (width, height, data) = match ranged(image, bits) {
            DynamicImage::ImageLuma8(image) => (image.width(), image.height(), image.into_raw()),
            other => {
                let luma = other.to_rgb8().as_raw().as_chunks().0.iter().map(luma).collect();
                (other.width(), other.height(), luma)
            }
        };
        Ok(Self { width, height, data })
    }

    /// Reads a mask: 0 where nothing is to be seen. A pixel that is not black stays above 0,
    /// however dark it is, as in files of 0 and 1 with 16 bits. If a part is transparent, as in a
    /// cut-out, that part is 0; its opaque part is not 0 where it is not black, or everywhere if
    /// all of it is black. `orientation` is that of EXIF by which a mask that has none is turned.
    pub(crate) fn read_mask(
        path: &Path,
        limit: &SizeLimit,
        turn: Turn,
        orientation: u8,
    ) -> Result<Self> {
        let image = decode_as(path, Planes::Luma, limit, turn, orientation)?;
        let (width, height) = (image.width(), image.height());
        if let DynamicImage::ImageLuma8(image) = image {
            return Ok(Self { width, height, data: image.into_raw() });
        }
        let opaque = opaque(&image);
        let data = match image.as_rgb8() {
            Some(image) => image.as_raw().as_chunks().0.iter().map(seen).collect::<Vec<u8>>(),
            // 16 bits become 8 without making a 1 to 0.
            None => image.to_rgb16().as_raw().as_chunks().0.iter().map(seen_of_16).collect(),
        };
        let Some(opaque) = opaque else { return Ok(Self { width, height, data }) };
        let is_all_black = data.iter().zip(&opaque).all(|(value, opaque)| !opaque || *value == 0);
        let of = |(value, opaque): (&u8, &bool)| match (opaque, is_all_black) {
            (false, _) => 0,
            (true, true) => u8::MAX,
            (true, false) => *value,
        };
        Ok(Self { width, height, data: data.iter().zip(&opaque).map(of).collect() })
    }

    /// The transparent part of a photo as a mask, 0 where it is transparent; `None` without one.
    pub(crate) fn read_transparency(
        path: &Path,
        limit: &SizeLimit,
        turn: Turn,
    ) -> Result<Option<Self>> {
        if !has_alpha(path)? {
            return Ok(None);
        }
        let image = decode(path, Planes::Rgb, limit, turn)?;
        Ok(opaque(&image).map(|opaque| Self {
            width: image.width(),
            height: image.height(),
            data: opaque.into_iter().map(|opaque| if opaque { u8::MAX } else { 0 }).collect(),
        }))
    }

    /// The image in another size, by the mean of the pixels that a new one covers; a smaller size
    /// is meant. An empty image stays empty.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let Some(image) = image::GrayImage::from_raw(self.width, self.height, self.data.clone())
        else {
            return Self::default();
        };
        let data = image::imageops::resize(&image, width, height, FilterType::Triangle).into_raw();
        Self { width, height, data }
    }

    /// Writes a PNG file, whatever the extension. The folder must exist.
    ///
    /// # Errors
    ///
    /// If the image does not have `width * height` bytes, and if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_png(path, &self.data, self.width, self.height, ExtendedColorType::L8)
    }
}

/// Writes a PNG file. Numbers of 16 bits have the byte order of the machine.
pub(crate) fn write_png(
    path: &Path,
    data: &[u8],
    width: u32,
    height: u32,
    color: ExtendedColorType,
) -> Result<()> {
    let bytes = png(path, data, width, height, color)?;
    Ok(AtomicFile::write_with(path, |file| file.write_all(&bytes))?)
}

/// The bytes of a PNG file; `path` is for errors.
fn png(
    path: &Path,
    data: &[u8],
    width: u32,
    height: u32,
    color: ExtendedColorType,
) -> Result<Vec<u8>> {
    let expected = u64::from(width) * u64::from(height) * u64::from(color.bits_per_pixel()) / 8;
    if expected != data.len() as u64 {
        let what = format!("{} bytes are no image of {width} × {height} pixels", data.len());
        return Err(Error::content(path, what));
    }
    let mut bytes = Cursor::new(Vec::new());
    image::write_buffer_with_format(&mut bytes, data, width, height, color, ImageFormat::Png)
        .map_err(|cause| Error::content(path, cause.to_string()))?;
    Ok(bytes.into_inner())
}

impl Rgb {
    /// Reads an image file, rotated as its EXIF orientation asks for.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is not an image, or has more than [`DEFAULT_MAX_PIXELS`].
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_within(path, &SizeLimit::Pixels(DEFAULT_MAX_PIXELS))
    }

    /// Reads an image of `width` × `height` pixels, without a limit of pixels.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is not an image, or has another size.
    pub fn read_of_size(path: &Path, width: u32, height: u32) -> Result<Self> {
        Self::read_within(path, &SizeLimit::of_photo(width, height))
    }

    /// Checks, by its header alone, that [`Rgb::read_of_size`] would accept the size of a file.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is not an image, or has another size.
    pub fn check_size(path: &Path, width: u32, height: u32) -> Result<()> {
        header(path, &SizeLimit::of_photo(width, height)).map(drop)
    }

    pub(crate) fn read_within(path: &Path, limit: &SizeLimit) -> Result<Self> {
        Self::read_turned(path, limit, Turn::Upright)
    }

    pub(crate) fn read_turned(path: &Path, limit: &SizeLimit, turn: Turn) -> Result<Self> {
        Self::read_ranged(path, limit, turn, || ALL_BITS)
    }

    /// As [`Luma::read_ranged`].
    pub(crate) fn read_ranged(
        path: &Path,
        limit: &SizeLimit,
        turn: Turn,
        bits: impl FnOnce() -> u32,
    ) -> Result<Self> {
        let image = ranged(decode(path, Planes::Rgb, limit, turn)?, bits).into_rgb8();
        Ok(Self { width: image.width(), height: image.height(), data: image.into_raw() })
    }

    /// Writes an image file by the extension: JPEG (quality 95), PNG, TIFF, WebP (lossless), BMP or
    /// PNM. The folder must exist.
    ///
    /// # Errors
    ///
    /// If the extension is unknown, and if the file cannot be encoded or written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let format = match path.extension() {
            // The crate knows all other names of JPEG.
            Some(ending) if ending.eq_ignore_ascii_case("jpe") => ImageFormat::Jpeg,
            _ => ImageFormat::from_path(path)
                .map_err(|cause| Error::content(path, cause.to_string()))?,
        };
        let mut bytes = Cursor::new(Vec::new());
        let color = ExtendedColorType::Rgb8;
        let (data, width, height) = (&self.data, self.width, self.height);
        let written = match format {
            ImageFormat::Jpeg => JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
                .encode(data, width, height, color),
            _ => image::write_buffer_with_format(&mut bytes, data, width, height, color, format),
        };
        written.map_err(|cause| Error::content(path, cause.to_string()))?;
        Ok(AtomicFile::write_with(path, |file| file.write_all(bytes.get_ref()))?)
    }

    /// The bytes of a PNG file.
    ///
    /// # Errors
    ///
    /// If the image does not have `3 * width * height` bytes.
    pub fn png(&self) -> Result<Vec<u8>> {
        png(Path::new("the picture"), &self.data, self.width, self.height, ExtendedColorType::Rgb8)
    }

    /// The bytes of a JPEG file.
    ///
    /// # Errors
    ///
    /// If the image has no pixels or a side of more than 65,535.
    pub fn jpeg(&self, quality: u8) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, quality)
            .encode(&self.data, self.width, self.height, ExtendedColorType::Rgb8)
            .map_err(|cause| Error::content(Path::new("the picture"), cause.to_string()))?;
        Ok(bytes)
    }

    /// The colour of the pixel in column x, row y.
    pub fn pixel(&self, x: u32, y: u32) -> [u8; 3] {
        let start = 3 * (y as usize * self.width as usize + x as usize);
        [self.data[start], self.data[start + 1], self.data[start + 2]]
    }
}

/// Luma 0.2126 R + 0.7152 G + 0.0722 B with 16 fractional bits, rounded.
fn luma([r, g, b]: &[u8; 3]) -> u8 {
    ((13_933 * u32::from(*r) + 46_871 * u32::from(*g) + 4_732 * u32::from(*b) + (1 << 15)) >> 16)
        as u8
}

/// As [`luma`], but 0 for black only.
fn seen(pixel: &[u8; 3]) -> u8 {
    luma(pixel).max(u8::from(*pixel != [0; 3]))
}

/// As [`seen`], of 16 bits.
fn seen_of_16(pixel: &[u16; 3]) -> u8 {
    luma(&pixel.map(|value| (value >> 8) as u8)).max(u8::from(*pixel != [0; 3]))
}

/// Which pixels are opaque by at least a half; `None` if none or all are.
fn opaque(image: &DynamicImage) -> Option<Vec<bool>> {
    if !image.color().has_alpha() {
        return None;
    }
    let opaque: Vec<bool> = image.to_rgba8().pixels().map(|pixel| pixel.0[3] >= 128).collect();
    (opaque.contains(&true) && opaque.contains(&false)).then_some(opaque)
}

/// Whether the header of a file has transparency.
fn has_alpha(path: &Path) -> Result<bool> {
    Ok(color_type(path)?.is_some_and(ColorType::has_alpha))
}

/// The channels and bits of the pixels by the header of a file; `None` for JPEG and what is no
/// image.
fn color_type(path: &Path) -> Result<Option<ColorType>> {
    let file = File::open(path).map_err(Error::io(path))?;
    let reader =
        ImageReader::new(BufReader::new(file)).with_guessed_format().map_err(Error::io(path))?;
    if matches!(reader.format(), None | Some(ImageFormat::Jpeg)) {
        return Ok(None);
    }
    let decoder = reader.into_decoder().map_err(|cause| Error::content(path, cause.to_string()))?;
    Ok(Some(decoder.color_type()))
}

/// Bits of a value of 16.
pub(crate) const ALL_BITS: u32 = 16;
/// Fewest bits that values of 16 are taken to have.
const LEAST_BITS: u32 = 8;

/// Whether the header of a file tells of 16 bits a channel.
pub(crate) fn is_deep(path: &Path) -> bool {
    use ColorType::{L16, La16, Rgb16, Rgba16};
    matches!(color_type(path), Ok(Some(L16 | La16 | Rgb16 | Rgba16)))
}

/// Bits that the values of an image of 16 bits a channel have, as 10 or 12 of machine vision; those
/// of transparency do not count.
pub(crate) fn bits_of(path: &Path, limit: &SizeLimit) -> Result<u32> {
    let image = decode(path, Planes::Luma, limit, Turn::AsStored)?;
    let most = match &image {
        DynamicImage::ImageLuma16(image) => image.as_raw().iter().max().copied(),
        DynamicImage::ImageRgb16(image) => image.as_raw().iter().max().copied(),
        DynamicImage::ImageLumaA16(image) => image.pixels().map(|pixel| pixel.0[0]).max(),
        DynamicImage::ImageRgba16(image) => {
            image.pixels().flat_map(|pixel| [pixel.0[0], pixel.0[1], pixel.0[2]]).max()
        }
        _ => None,
    };
    Ok(most.map_or(ALL_BITS, |most| (u16::BITS - most.leading_zeros()).max(LEAST_BITS)))
}

/// Scales values of so many bits to 16, if the image has 16 bits a channel.
fn ranged(mut image: DynamicImage, bits: impl FnOnce() -> u32) -> DynamicImage {
    let is_deep = image.color().bytes_per_pixel() == 2 * image.color().channel_count();
    let bits = if is_deep { bits() } else { ALL_BITS };
    if bits >= ALL_BITS {
        return image;
    }
    let most = (1_u32 << bits) - 1;
    let scale = |value: &mut u16| {
        *value = ((u32::from(*value).min(most) * u32::from(u16::MAX) + most / 2) / most) as u16;
    };
    match &mut image {
        DynamicImage::ImageLuma16(image) => image.iter_mut().for_each(scale),
        DynamicImage::ImageRgb16(image) => image.iter_mut().for_each(scale),
        DynamicImage::ImageLumaA16(image) => {
            image.pixels_mut().for_each(|pixel| pixel.0[..1].iter_mut().for_each(scale));
        }
        DynamicImage::ImageRgba16(image) => {
            image.pixels_mut().for_each(|pixel| pixel.0[..3].iter_mut().for_each(scale));
        }
        _ => {}
    }
    image
}

/// How the pixels of a file become an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Turn {
    /// Rotated as the EXIF orientation asks for.
    #[default]
    Upright,
    /// In the order of the file, as COLMAP and many readers of its models take them.
    AsStored,
}

impl Turn {
    /// The orientation to apply.
    fn orientation(self, exif: &Exif) -> u8 {
        match self {
            Self::Upright => exif.orientation,
            Self::AsStored => 1,
        }
    }
}

/// [`SizeLimit::Size::what`] of a mask.
pub(crate) const MASK: &str = "the mask";

/// The permitted sizes of an upright image.
pub(crate) enum SizeLimit<'a> {
    /// At most so many pixels.
    Pixels(u64),
    /// Exactly this size; `what` and `of` name the image and the origin of the size in the error.
    Size { width: u32, height: u32, what: &'a str, of: &'a str },
}

impl SizeLimit<'_> {
    /// The size of the camera of a photo.
    pub(crate) fn of_photo(width: u32, height: u32) -> Self {
        Self::Size { width, height, what: "the photo", of: "the camera of its model" }
    }

    /// Checks the size of an upright image; the error is the end of a sentence about the file.
    pub(crate) fn check(&self, width: u32, height: u32) -> Result<(), String> {
        let pixels = u64::from(width) * u64::from(height);
        match *self {
            _ if pixels == 0 => Err(format!("has {width} × {height} pixels")),
            Self::Size { width: w, height: h, what, of } if (w, h) != (width, height) => {
                let remedy = match what {
                    MASK => ": give it the size of its photo",
                    _ => "",
                };
                Err(format!("{what} has {width} × {height} pixels, {of} has {w} × {h}{remedy}"))
            }
            _ if pixels > ABSOLUTE_MAX_PIXELS => {
                let most = ABSOLUTE_MAX_PIXELS / MILLION;
                Err(format!(
                    "claims {width} × {height} pixels, and more than {most} million are never \
                    read: make it smaller"
                ))
            }
            Self::Pixels(most) if pixels > most => Err(format!(
                "claims {width} × {height} pixels, more than {} million: if it is a photo, give \
                `features.max_megapixels` {}",
                most / MILLION,
                pixels.div_ceil(MILLION)
            )),
            _ => Ok(()),
        }
    }
}

/// EXIF data, width and height of an upright image.
pub(crate) fn header(path: &Path, limit: &SizeLimit) -> Result<(Exif, u32, u32)> {
    header_turned(path, limit, Turn::Upright)
}

/// EXIF data, width and height of an image.
pub(crate) fn header_turned(
    path: &Path,
    limit: &SizeLimit,
    turn: Turn,
) -> Result<(Exif, u32, u32)> {
    // Checked before the EXIF data, because those of a TIFF file may be anywhere in the file.
    let stored = stored_size(path)?;
    refuse_preview(path, stored)?;
    let exif = Exif::read(path)?;
    let (width, height) = turned_size(path, turn.orientation(&exif), stored, limit)?;
    Ok((exif, width, height))
}

/// Refuses a TIFF file whose first page, the one that is read, is smaller than another one.
fn refuse_preview(path: &Path, (width, height): (u32, u32)) -> Result<()> {
    let area = |size: [u32; 2]| u64::from(size[0]) * u64::from(size[1]);
    let pages = tiff_pages::sizes(path);
    match (1..).zip(&pages).max_by_key(|(_, size)| area(**size)) {
        Some((page, size)) if area(*size) > area([width, height]) => {
            let [larger_width, larger_height] = *size;
            let what = format!(
                "its first page has {width} × {height} pixels, as a preview, and page {page} has \
                 {larger_width} × {larger_height}: save that page alone"
            );
            Err(Error::content(path, what))
        }
        _ => Ok(()),
    }
}

/// Whether a file begins as a JPEG file does.
pub(crate) fn is_photo_by_content(path: &Path) -> bool {
    let mut head = [0; 3];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut head));
    read.is_ok() && head == [0xFF, 0xD8, 0xFF]
}

/// Size of an image as it is stored, and the orientation of its EXIF data.
pub(crate) fn stored(path: &Path) -> Result<((u32, u32), u8)> {
    Ok((stored_size(path)?, Exif::read(path)?.orientation))
}

/// Size of an image after the rotation of an EXIF orientation, from the stored size.
pub(crate) fn turned_size(
    path: &Path,
    orientation: u8,
    stored: (u32, u32),
    limit: &SizeLimit,
) -> Result<(u32, u32)> {
    let (width, height) = if orientation >= 5 { (stored.1, stored.0) } else { stored };
    limit.check(width, height).map_err(|what| Error::content(path, what))?;
    Ok((width, height))
}

/// Stored size of an image, from its header alone; an error if the length of the file is impossible
/// for that size.
fn stored_size(path: &Path) -> Result<(u32, u32)> {
    let content = |what: String| Error::content(path, what);
    let file = File::open(path).map_err(Error::io(path))?;
    let length = file.metadata().map_err(Error::io(path))?.len();
    if length == 0 {
        return Err(Error::content(path, "is empty"));
    }
    // The content decides the format, not the extension.
    let reader =
        ImageReader::new(BufReader::new(file)).with_guessed_format().map_err(Error::io(path))?;
    let format = reader.format().ok_or_else(|| not_an_image(path))?;
    let (width, height, min_bytes) = if format == ImageFormat::Jpeg {
        let frame = jpeg::frame(&mut reader.into_inner());
        let frame = frame
            .ok_or_else(|| content("the JPEG data has no header, or is truncated".to_owned()))?;
        (frame.width, frame.height, frame.min_bytes)
    } else {
        let (width, height) =
            reader.into_dimensions().map_err(|cause| content(cause.to_string()))?;
        // No lower bound for TIFF: strips may share the same bytes.
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
    let pixels = u64::from(width) * u64::from(height);
    let most_bytes = pixels.saturating_mul(MAX_BYTES_PER_PIXEL).saturating_add(MAX_BYTES_BESIDE);
    if length > most_bytes {
        return Err(content(format!(
            "has {length} bytes, far too many for {width} × {height} pixels"
        )));
    }
    Ok((width, height))
}

/// Bytes of the rows of a PNG file after decompression.
fn png_bytes(path: &Path, width: u32, height: u32) -> Result<u64> {
    // Offset after signature, length, name, width and height.
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
    Ok(u64::from(height).saturating_mul(1 + bits.div_ceil(8)))
}

fn not_an_image(path: &Path) -> Error {
    Error::content(path, "is no JPEG, PNG, TIFF, WebP, BMP or PNM image")
}

fn decode(path: &Path, planes: Planes, limit: &SizeLimit, turn: Turn) -> Result<DynamicImage> {
    decode_as(path, planes, limit, turn, 1)
}

/// Decodes a file; `orientation` is that of a file whose EXIF data have none.
fn decode_as(
    path: &Path,
    planes: Planes,
    limit: &SizeLimit,
    turn: Turn,
    orientation: u8,
) -> Result<DynamicImage> {
    // Checks the size in the header before the file is read. The orientation does not change the
    // memory that decoding takes.
    let (width, height) = stored_size(path)?;
    let either =
        limit.check(width, height).or_else(|what| limit.check(height, width).map_err(|_| what));
    either.map_err(|what| Error::content(path, what))?;
    let bytes = std::fs::read(path).map_err(Error::io(path))?;
    let orientation = match turn.orientation(&Exif::from_bytes(&bytes)) {
        1 => orientation,
        own => own,
    };
    turned_size(path, orientation, (width, height), limit)?;
    let mut image = match image::guess_format(&bytes) {
        Ok(ImageFormat::Jpeg) => {
            let decoded = jpeg::decode(&bytes, planes, (width, height))
                .map_err(|what| Error::content(path, what))?;
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
            // Bytes for four channels of 16 bits, and overhead.
            limits.max_alloc = Some(8 * u64::from(width) * u64::from(height) + (64 << 20));
            reader.limits(limits);
            reader.decode().map_err(|cause| Error::content(path, cause.to_string()))?
        }
        Err(_) => return Err(not_an_image(path)),
    };
    image.apply_orientation(
        Orientation::from_exif(orientation).unwrap_or(Orientation::NoTransforms),
    );
    Ok(image)
}
