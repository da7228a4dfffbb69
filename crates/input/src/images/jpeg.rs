//! JPEG files. The decoder is used directly rather than through `image` for two reasons: it decodes
//! grey files without a conversion to colours; and `image` silently fills the missing part of a
//! truncated file with grey.

use std::collections::BTreeMap;
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
/// decoder may find another one. A file without the end of its image is decoded if it is complete.
pub(crate) fn decode(bytes: &[u8], planes: Planes, size: (u32, u32)) -> Result<Decoded, String> {
    if has_end(bytes) {
        return decode_to_end(bytes, planes, size);
    }
    decode_without_end(bytes, planes, size).ok_or_else(|| "the JPEG data is truncated".to_owned())
}

/// Bytes in place of those that a truncated file lacks: codes of many kinds, without markers.
const OTHER_ENDS: [u8; 2] = [0x5A, 0xC9];
/// Number of those: a block of 8 × 8 samples has at most 64 codes of 32 bits.
const OTHER_END_BYTES: usize = 256;

/// Decodes a file that lacks the end marker. It is complete if all bits of all coefficients are
/// coded and if the decoder needs nothing of what follows: other bytes there change no pixel.
fn decode_without_end(bytes: &[u8], planes: Planes, size: (u32, u32)) -> Option<Decoded> {
    // The rest of a block of a card that was never written. A scan ends with bits 1.
    let used = bytes.iter().rposition(|byte| !matches!(byte, 0x00 | 0xFF))? + 1;
    let mut data = bytes[..used].to_vec();
    if bytes.get(used..used + 2) == Some(&[0xFF, 0x00]) {
        data.extend([0xFF, 0x00]);
    }
    if !codes_all_bits(&data) {
        return None;
    }
    let with = |end: &[u8]| decode_to_end(&[&data, end, &END_OF_IMAGE].concat(), planes, size).ok();
    let decoded = with(&[])?;
    let is_same =
        |end: u8| with(&[end; OTHER_END_BYTES]).is_some_and(|other| other.bytes == decoded.bytes);
    OTHER_ENDS.into_iter().all(is_same).then_some(decoded)
}

/// Whether the scans that begin in a file have all bits of all coefficients of all components: a
/// progressive file has them in several scans (ITU-T T.81, G.1.1.1).
fn codes_all_bits(bytes: &[u8]) -> bool {
    let mut reader = std::io::Cursor::new(bytes);
    let mut components: Vec<u8> = Vec::new();
    let mut coded: BTreeMap<u8, u64> = BTreeMap::new();
    while let Some((marker, length)) = next_segment(&mut reader) {
        let begin = reader.position() as usize;
        let Some(content) = bytes.get(begin..begin + usize::from(length)) else { break };
        match (marker, content) {
            // Precision, height, width, and the components: identifier, sampling, table.
            (0xC0..=0xC2, [_, _, _, _, _, _, of_components @ ..]) => {
                components = of_components.chunks_exact(3).map(|component| component[0]).collect();
            }
            // The components: identifier, tables. First and last coefficient, bits before and
            // after.
            (START_OF_SCAN, [_, of_components @ .., first, last, bits]) if bits & 15 == 0 => {
                let coefficients = (*first..=(*last).min(63)).fold(0, |all, k| all | 1_u64 << k);
                for component in of_components.chunks_exact(2) {
                    *coded.entry(component[0]).or_default() |= coefficients;
                }
            }
            _ => {}
        }
        reader.set_position((begin + content.len()) as u64);
    }
    !components.is_empty() && components.iter().all(|id| coded.get(id) == Some(&u64::MAX))
}

/// Decodes a file that has the end of its image.
fn decode_to_end(
    bytes: &[u8],
    planes: Planes,
    (width, height): (u32, u32),
) -> Result<Decoded, String> {
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
fn has_end(bytes: &[u8]) -> bool {
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

/// Begins an XMP packet in the segment of an application (XMP specification, part 3, 1.1.3).
const XMP: &[u8] = b"http://ns.adobe.com/xap/1.0/\0";

/// Whether the XMP data name a projection of a panorama, as an attribute or as an element (Photo
/// Sphere XMP metadata of Google, `GPano`).
pub(crate) fn is_panorama(reader: &mut (impl BufRead + Seek)) -> bool {
    let mut start = [0; 2];
    if reader.read_exact(&mut start).is_err() || start != [0xFF, 0xD8] {
        return false;
    }
    let projection = b"GPano:ProjectionType";
    while let Some((marker, length)) = next_segment(reader) {
        if marker == START_OF_SCAN {
            break;
        }
        let mut content = vec![0; usize::from(length)];
        if reader.read_exact(&mut content).is_err() {
            break;
        }
        if marker == 0xE1
            && content.starts_with(XMP)
            && content.windows(projection.len()).any(|text| text == projection)
        {
            return true;
        }
    }
    false
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
