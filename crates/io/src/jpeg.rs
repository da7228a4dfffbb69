//! JPEG files. The decoder is used directly rather than through `image` for two reasons: it decodes
//! grey files without a conversion to colours; and `image` silently fills the missing part of a
//! truncated file with grey.

use std::io::{BufRead, Seek, SeekFrom};

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;

/// The planes to decode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Planes {
    Luma,
    Rgb,
}

/// Decoded bytes, by rows.
pub(crate) struct Decoded {
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// The decoded planes: luma only if requested and if the file has no other planes.
    pub(crate) planes: Planes,
    pub(crate) bytes: Vec<u8>,
}

/// Decodes an image whose first frame header claims this width and height. In a damaged file the
/// decoder may find another one.
pub(crate) fn decode(
    bytes: &[u8],
    planes: Planes,
    (width, height): (u32, u32),
) -> Result<Decoded, String> {
    if !is_complete(bytes) {
        return Err("the JPEG data is truncated".to_owned());
    }
    // The sides of a JPEG image fit 16 bits. Not strict: cameras pad their headers.
    let side = usize::from(u16::MAX);
    let options =
        DecoderOptions::default().set_strict_mode(false).set_max_width(side).set_max_height(side);
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    let message = |error| format!("cannot decode the JPEG data: {error:?}");
    decoder.decode_headers().map_err(message)?;
    let info = decoder.info().ok_or("the JPEG data has no header")?;
    let (last_width, last_height) = (u32::from(info.width), u32::from(info.height));
    if (width, height) != (last_width, last_height) {
        return Err(format!(
            "the JPEG data has frame headers of {width} × {height} and of {last_width} × \
             {last_height} pixels"
        ));
    }
    let is_grey = decoder.input_colorspace() == Some(ColorSpace::Luma);
    let (planes, space) = match planes {
        Planes::Luma if is_grey => (Planes::Luma, ColorSpace::Luma),
        _ => (Planes::Rgb, ColorSpace::RGB),
    };
    decoder.set_options(options.jpeg_set_out_colorspace(space));
    let bytes = decoder.decode().map_err(message)?;
    Ok(Decoded { width, height, planes, bytes })
}

const END_OF_IMAGE: [u8; 2] = [0xFF, 0xD9];
const START_OF_SCAN: u8 = 0xDA;

/// Whether the file contains the end of its image. Within a scan a byte FF is followed by 00 or a
/// marker, so that the first FF D9 after the beginning of the first scan is the end. The end marker
/// of a thumbnail comes earlier.
fn is_complete(bytes: &[u8]) -> bool {
    let mut reader = std::io::Cursor::new(bytes);
    while let Some((marker, _)) = next_segment(&mut reader) {
        if marker == START_OF_SCAN {
            let scan = bytes.get(reader.position() as usize..).unwrap_or_default();
            return scan.windows(2).any(|pair| pair == END_OF_IMAGE);
        }
    }
    false
}

/// The header of the first frame (in the sense of JPEG).
pub(crate) struct Frame {
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// Lower bound of the compressed data in bytes: every block of 8 × 8 samples has a DC
    /// coefficient, and its Huffman code has one bit or more (ITU-T T.81, F.1.2.1 and G.1.2.1).
    pub(crate) min_bytes: u64,
}

/// Reads the header of the first frame.
pub(crate) fn frame(reader: &mut (impl BufRead + Seek)) -> Option<Frame> {
    reader.seek(SeekFrom::Start(0)).ok()?;
    while let Some((marker, length)) = next_segment(reader) {
        match marker {
            // Start of frame, of any kind: precision, height, width, components. (C4, C8 and CC are
            // other markers.)
            0xC0..=0xCF if !matches!(marker, 0xC4 | 0xC8 | 0xCC) => {
                let mut frame = [0; 6];
                reader.read_exact(&mut frame).ok()?;
                let [_, h1, h0, w1, w0, count] = frame;
                // Each component: identifier, horizontal and vertical sampling factors,
                // quantisation table.
                let mut components = vec![0; 3 * usize::from(count)];
                reader.read_exact(&mut components).ok()?;
                let samplings: Vec<[u64; 2]> = components
                    .chunks(3)
                    .map(|c| [u64::from(c[1] >> 4), u64::from(c[1] & 15)])
                    .collect();
                let size = [[w1, w0], [h1, h0]].map(|side| u64::from(u16::from_be_bytes(side)));
                let most =
                    [0, 1].map(|axis| samplings.iter().map(|s| s[axis]).max().unwrap_or(0).max(1));
                let blocks = |sampling: &[u64; 2]| -> u64 {
                    [0, 1]
                        .map(|axis| (size[axis] * sampling[axis]).div_ceil(8 * most[axis]))
                        .iter()
                        .product()
                };
                return Some(Frame {
                    width: size[0] as u32,
                    height: size[1] as u32,
                    min_bytes: samplings.iter().map(blocks).sum::<u64>() / 8,
                });
            }
            START_OF_SCAN => return None,
            _ => {
                reader.seek_relative(i64::from(length)).ok()?;
            }
        };
    }
    None
}

/// Marker and length of the next segment; the reader is then at the content of the segment.
fn next_segment(reader: &mut (impl BufRead + Seek)) -> Option<(u8, u16)> {
    let mut byte = [0];
    loop {
        // Fill bytes FF may precede a marker.
        reader.read_exact(&mut byte).ok()?;
        if byte[0] != 0xFF {
            continue;
        }
        while byte[0] == 0xFF {
            reader.read_exact(&mut byte).ok()?;
        }
        // 00 is not a marker; start of image and restart markers have no length.
        if !matches!(byte[0], 0x00 | 0x01 | 0xD0..=0xD8) {
            break;
        }
    }
    let mut length = [0; 2];
    reader.read_exact(&mut length).ok()?;
    Some((byte[0], u16::from_be_bytes(length).saturating_sub(2)))
}
