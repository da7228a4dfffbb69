//! Check of the header of a LAS or LAZ file against the length of the file: the packages `las` and
//! `laz` allocate whatever a header claims, and panic if its parts contradict each other.
//!
//! Offsets are those of the public header block of LAS 1.4 R15 (ASPRS 2019, table 3) and of the
//! laszip record (Isenburg 2013, "LASzip: lossless compression of LiDAR data"; the layered chunks
//! as in lasreaditemcompressed_v3 of `laszip`).

use std::io::{Read, Seek, SeekFrom};

/// Length of the public header block up to version 1.2; later versions append to it.
const HEADER_BYTES: usize = 227;
/// Length of the public header block of version 1.4.
const HEADER_BYTES_1_4: usize = 375;
/// Length of the header of a variable length record, and of an extended one.
const VLR_BYTES: u64 = 54;
const EVLR_BYTES: u64 = 60;
/// Bytes of a point of each format, without extra bytes (LAS 1.4 R15, table 6).
const POINT_BYTES: [u16; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];
/// Whether points of each format have a time, colours, near infrared and a wave packet: LAZ
/// compresses them as separate items.
const HAS_TIME: [bool; 6] = [false, true, false, true, true, true];
const HAS_COLOR: [bool; 11] =
    [false, false, true, true, false, true, false, true, true, false, true];
const HAS_NIR: [bool; 11] =
    [false, false, false, false, false, false, false, false, true, false, true];
const HAS_WAVE: [bool; 11] =
    [false, false, false, false, true, true, false, false, false, true, true];
/// The first format that LAZ compresses in layers.
const FIRST_LAYERED: usize = 6;
/// Most extra bytes of a compressed point. Each costs the decompressor some kilobytes of models;
/// scanners append a dozen.
const MAX_EXTRA_BYTES: u16 = 256;
/// Most points in a byte of compressed data. Clouds of scanners take one to five bytes a point;
/// only regular patterns of points take less.
const MAX_POINTS_PER_BYTE: u64 = 64;
/// User id and record id of the laszip record.
const LASZIP_USER: &[u8] = b"laszip encoded\0\0";
const LASZIP_RECORD: u16 = 22_204;
/// Layers of a point of format 6: place, height, class, flags, intensity, angle, user data, source,
/// time.
const POINT_LAYERS: u64 = 9;
/// Types of items in the laszip record.
const ITEM_BYTES: [u16; 2] = [0, 14];
const ITEM_POINT: [u16; 2] = [6, 10];
const ITEM_COLOR: [u16; 2] = [8, 11];
const ITEM_TIME: u16 = 7;
const ITEM_COLOR_NIR: u16 = 12;
const ITEM_WAVE: [u16; 2] = [9, 13];
/// Types of compression.
const POINT_WISE_CHUNKED: u16 = 2;
const LAYERED_CHUNKED: u16 = 3;
const VARIABLE_CHUNKS: [u32; 2] = [0, u32::MAX];

/// A file and its length.
pub(super) struct Claims<R> {
    file: R,
    length: u64,
}

/// The fields of the public header that are used.
struct Header {
    header_bytes: u64,
    data_offset: u64,
    num_vlrs: u32,
    /// Format of the points.
    format: usize,
    is_compressed: bool,
    record_bytes: u16,
    points: u64,
}

impl<R: Read + Seek> Claims<R> {
    pub(super) fn new(mut file: R) -> std::io::Result<Self> {
        let length = file.seek(SeekFrom::End(0))?;
        Ok(Self { file, length })
    }

    /// Returns the number of points and the bytes of each, or the claim that cannot be true.
    pub(super) fn check(mut self) -> Result<(u64, u64), String> {
        let header = self.header()?;
        let data_bytes = self.length.checked_sub(header.data_offset).ok_or_else(|| {
            format!(
                "its points begin at byte {}, but it has {} bytes",
                header.data_offset, self.length
            )
        })?;
        if header.is_compressed {
            let most = data_bytes.saturating_mul(MAX_POINTS_PER_BYTE);
            if header.points > most {
                let points = header.points;
                return Err(format!(
                    "announces {points} points, but only {data_bytes} bytes of compressed data \
                    follow"
                ));
            }
            self.check_compression(&header)?;
        } else if u64::from(header.record_bytes)
            .checked_mul(header.points)
            .is_none_or(|all| all > data_bytes)
        {
            let Header { points, record_bytes, .. } = header;
            return Err(format!(
                "announces {points} points of {record_bytes} bytes, but only {data_bytes} bytes \
                follow"
            ));
        }
        Ok((header.points, u64::from(header.record_bytes)))
    }

    fn header(&mut self) -> Result<Header, String> {
        let mut bytes = Vec::new();
        self.file.seek(SeekFrom::Start(0)).map_err(|cause| cause.to_string())?;
        let taken = self.file.by_ref().take(HEADER_BYTES_1_4 as u64).read_to_end(&mut bytes);
        taken.map_err(|cause| cause.to_string())?;
        if bytes.len() < HEADER_BYTES || !bytes.starts_with(b"LASF") {
            return Err("is no LAS file, or ends within its header".to_owned());
        }
        let byte = |at: usize| bytes[at];
        let short = |at: usize| u16::from_le_bytes([byte(at), byte(at + 1)]);
        let word =
            |at: usize| u32::from_le_bytes([byte(at), byte(at + 1), byte(at + 2), byte(at + 3)]);
        let is_1_4 = (byte(24), byte(25)) >= (1, 4);
        let mut points = u64::from(word(107));
        if is_1_4 {
            if bytes.len() < HEADER_BYTES_1_4 {
                return Err("ends within its header".to_owned());
            }
            let long = |at: usize| u64::from(word(at)) | u64::from(word(at + 4)) << 32;
            if points == 0 {
                points = long(247);
            }
            self.check_extended_records(long(235), word(243))?;
        }
        // LAZ sets either of the two high bits of the format of compressed points.
        let (format, is_compressed) = (usize::from(byte(104) & 0x3F), byte(104) & 0xC0 != 0);
        let least = *POINT_BYTES
            .get(format)
            .ok_or_else(|| format!("has points of unknown format {format}"))?;
        let record_bytes = short(105);
        if record_bytes < least {
            return Err(format!(
                "has points of {record_bytes} bytes, but format {format} takes {least}"
            ));
        }
        Ok(Header {
            header_bytes: u64::from(short(94)),
            data_offset: u64::from(word(96)),
            num_vlrs: word(100),
            format,
            is_compressed,
            record_bytes,
            points,
        })
    }

    /// Checks that the extended records, which follow the points, end within the file.
    fn check_extended_records(&mut self, mut offset: u64, count: u32) -> Result<(), String> {
        for _ in 0..count {
            let length: [u8; 8] = self.bytes(offset.saturating_add(20))?;
            let end = offset
                .checked_add(EVLR_BYTES)
                .and_then(|o| o.checked_add(u64::from_le_bytes(length)));
            offset = end.filter(|end| *end <= self.length).ok_or_else(|| {
                format!(
                    "an extended record at byte {offset} is longer than the {} bytes of the file",
                    self.length
                )
            })?;
        }
        Ok(())
    }

    /// The data of the laszip record.
    fn laszip_record(&mut self, header: &Header) -> Result<Vec<u8>, String> {
        let mut offset = header.header_bytes;
        for _ in 0..header.num_vlrs {
            let head: [u8; VLR_BYTES as usize] = self.bytes(offset)?;
            let length = u16::from_le_bytes([head[20], head[21]]);
            offset += VLR_BYTES;
            if head[2..].starts_with(LASZIP_USER) && head[18..20] == LASZIP_RECORD.to_le_bytes() {
                let mut data = vec![0; usize::from(length)];
                self.fill(offset, &mut data)?;
                return Ok(data);
            }
            offset += u64::from(length);
        }
        Err("is compressed, but does not say how".to_owned())
    }

    fn check_compression(&mut self, header: &Header) -> Result<(), String> {
        let record = self.laszip_record(header)?;
        let short = |at: usize| Some(u16::from_le_bytes([*record.get(at)?, *record.get(at + 1)?]));
        let chunk_points = || Some(u32::from(short(12)?) | u32::from(short(14)?) << 16);
        let broken = || "the record on its compression is broken".to_owned();
        let (compressor, chunk_points) = short(0).zip(chunk_points()).ok_or_else(broken)?;
        let count = usize::from(short(32).ok_or_else(broken)?);
        let items =
            (0..count).map(|k| Some((short(34 + 6 * k)?, short(36 + 6 * k)?, short(38 + 6 * k)?)));
        let items: Vec<(u16, u16, u16)> = items.collect::<Option<_>>().ok_or_else(broken)?;
        let extra = header.record_bytes - POINT_BYTES[header.format];
        if extra > MAX_EXTRA_BYTES {
            return Err(format!(
                "its compressed points have {extra} extra bytes, and at most {MAX_EXTRA_BYTES} \
                are read"
            ));
        }
        let is_layered = header.format >= FIRST_LAYERED;
        let kinds: Vec<u16> = items.iter().map(|item| item.0).collect();
        let versions = if is_layered { 3..=4 } else { 1..=2 };
        let is_known = (compressor == LAYERED_CHUNKED) == is_layered
            && kinds == expected_items(header.format, extra)
            && items.iter().all(|(.., version)| versions.contains(version))
            && items.iter().all(|(kind, bytes, _)| !ITEM_BYTES.contains(kind) || *bytes == extra);
        if !is_known {
            return Err(format!("its compression does not fit points of format {}", header.format));
        }
        let is_variable = VARIABLE_CHUNKS.contains(&chunk_points);
        if compressor == POINT_WISE_CHUNKED && is_variable {
            return Err(
                "its chunks are of several lengths, which is not supported for this format"
                    .to_owned(),
            );
        }
        let chunks = match compressor {
            POINT_WISE_CHUNKED | LAYERED_CHUNKED => self.num_chunks(header)?,
            _ => None,
        };
        if !is_layered {
            return Ok(());
        }
        // The decompressor divides the points into chunks by the numbers in the chunk table, or
        // else by a fixed number.
        let chunks = match (is_variable, chunks) {
            (false, _) => header.points.div_ceil(u64::from(chunk_points)),
            (true, Some(chunks)) => chunks,
            (true, None) => {
                return Err("its chunks are of several lengths, and no table tells them".to_owned());
            }
        };
        self.check_layers(header, extra, chunks)
    }

    /// The number of chunks in the chunk table, if there is one. A chunk holds at least one
    /// uncompressed point.
    fn num_chunks(&mut self, header: &Header) -> Result<Option<u64>, String> {
        let mut offset = i64::from_le_bytes(self.bytes(header.data_offset)?);
        if offset <= header.data_offset as i64 {
            // Writers that cannot seek store the offset at the end of the file.
            offset = i64::from_le_bytes(self.bytes(self.length.saturating_sub(8))?);
        }
        if offset <= header.data_offset as i64 {
            return Ok(None);
        }
        let count = u32::from_le_bytes(self.bytes((offset as u64).saturating_add(4))?);
        if u64::from(count) > self.length / u64::from(POINT_BYTES[0]) {
            return Err(format!("announces {count} chunks of points in {} bytes", self.length));
        }
        Ok(Some(u64::from(count)))
    }

    /// Checks the layered chunks: first point, number of points, lengths of the layers, layers.
    fn check_layers(&mut self, header: &Header, extra: u16, chunks: u64) -> Result<(), String> {
        let format = header.format;
        let others = [HAS_COLOR[format], HAS_NIR[format], HAS_WAVE[format]];
        let layers = POINT_LAYERS + others.map(u64::from).iter().sum::<u64>() + u64::from(extra);
        let mut sizes = vec![0; 4 * layers as usize];
        // The offset of the chunk table precedes the first chunk.
        let mut offset = header.data_offset + 8;
        for _ in 0..chunks {
            let sizes_at = offset + u64::from(header.record_bytes) + 4;
            self.fill(sizes_at, &mut sizes)?;
            let sizes = sizes.as_chunks::<4>().0.iter();
            let sum: u64 = sizes.map(|size| u64::from(u32::from_le_bytes(*size))).sum();
            offset = sizes_at + 4 * layers + sum;
            if offset > self.length {
                return Err(format!(
                    "a chunk of points at byte {sizes_at} claims {sum} bytes, more than the {} of \
                    the file",
                    self.length
                ));
            }
        }
        Ok(())
    }

    fn bytes<const N: usize>(&mut self, offset: u64) -> Result<[u8; N], String> {
        let mut bytes = [0; N];
        self.fill(offset, &mut bytes)?;
        Ok(bytes)
    }

    fn fill(&mut self, offset: u64, bytes: &mut [u8]) -> Result<(), String> {
        let read =
            self.file.seek(SeekFrom::Start(offset)).and_then(|_| self.file.read_exact(bytes));
        read.map_err(|_| format!("ends before byte {}", offset.saturating_add(bytes.len() as u64)))
    }
}

/// The types of the items of points of a format.
fn expected_items(format: usize, extra: u16) -> Vec<u16> {
    let is_layered = usize::from(format >= FIRST_LAYERED);
    let mut kinds = vec![ITEM_POINT[is_layered]];
    if HAS_TIME.get(format) == Some(&true) {
        kinds.push(ITEM_TIME);
    }
    if HAS_COLOR[format] {
        kinds.push(if HAS_NIR[format] { ITEM_COLOR_NIR } else { ITEM_COLOR[is_layered] });
    }
    if HAS_WAVE[format] {
        kinds.push(ITEM_WAVE[is_layered]);
    }
    if extra > 0 {
        kinds.push(ITEM_BYTES[is_layered]);
    }
    kinds
}
