//! Boxes of MP4 files (ISO/IEC 14496-12).

use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;

/// Upper limit in bytes of a box or sample that is read: of a whole day, the table of sizes of
/// samples of a second has 350 kB, and a second of telemetry some 50 kB.
const MAX_LEN: u64 = 1 << 22;

/// The bytes of a range; `None` for one of more than 4 MiB.
pub(super) fn read_range(
    file: &mut (impl Read + Seek),
    range: Range<u64>,
) -> io::Result<Option<Vec<u8>>> {
    let len = range.end - range.start;
    if len > MAX_LEN {
        return Ok(None);
    }
    file.seek(SeekFrom::Start(range.start))?;
    let mut bytes = Vec::new();
    file.take(len).read_to_end(&mut bytes)?;
    Ok(Some(bytes))
}

/// The byte range of the content of a box, by the names of the boxes around it and its own. `None`
/// if one is missing.
pub(super) fn find_path(
    file: &mut (impl Read + Seek),
    mut within: Range<u64>,
    names: &[&[u8; 4]],
) -> io::Result<Option<Range<u64>>> {
    for name in names {
        let found = find_boxes(file, within, name)?;
        let Some(first) = found.into_iter().next() else { return Ok(None) };
        within = first;
    }
    Ok(Some(within))
}

/// The byte ranges of the contents of the boxes called `name` in a range. The search ends at bytes
/// that are no box.
pub(super) fn find_boxes(
    file: &mut (impl Read + Seek),
    within: Range<u64>,
    name: &[u8; 4],
) -> io::Result<Vec<Range<u64>>> {
    let mut found = Vec::new();
    let mut at = within.start;
    while at + 8 <= within.end {
        file.seek(SeekFrom::Start(at))?;
        let mut head = [0; 16];
        let head_len = if within.end - at >= 16 { 16 } else { 8 };
        file.read_exact(&mut head[..head_len])?;
        let [a, b, c, d, ..] = head;
        let (start, size) = match u32::from_be_bytes([a, b, c, d]) {
            0 => (8, within.end - at),
            1 if head_len == 16 => (16, u64::from_be_bytes(std::array::from_fn(|k| head[8 + k]))),
            size => (8, u64::from(size)),
        };
        if size < start || size > within.end - at {
            break;
        }
        if head[4..8] == *name {
            found.push(at + start..at + size);
        }
        at += size;
    }
    Ok(found)
}

/// A sample of a track: its bytes, and when it begins and ends, in seconds.
#[derive(Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) bytes: Range<u64>,
    pub(super) times_s: Range<f64>,
}

/// The samples of the first track of a format, by the four letters of its sample description.
/// `None` if there is no such track, or its tables are damaged.
pub(super) fn samples(
    file: &mut (impl Read + Seek),
    length: u64,
    format: &[u8; 4],
) -> io::Result<Option<Vec<Sample>>> {
    let Some(moov) = find_path(file, 0..length, &[b"moov"])? else { return Ok(None) };
    for track in find_boxes(file, moov, b"trak")? {
        let Some(media) = find_path(file, track, &[b"mdia"])? else { continue };
        let Some(table) = find_path(file, media.clone(), &[b"minf", b"stbl"])? else { continue };
        let mut content =
            |within: &Range<u64>, name: &[u8; 4]| match find_path(file, within.clone(), &[name])? {
                Some(range) => read_range(file, range),
                None => Ok(None),
            };
        let description = content(&table, b"stsd")?;
        if description.is_none_or(|bytes| bytes.get(12..16) != Some(format)) {
            continue;
        }
        let mut of_table = |name: &[u8; 4]| content(&table, name);
        let [durations, sizes, chunks] =
            [of_table(b"stts")?, of_table(b"stsz")?, of_table(b"stsc")?];
        let (near, far) = (of_table(b"stco")?, of_table(b"co64")?);
        let header = content(&media, b"mdhd")?;
        let tables = || {
            let offsets: Vec<u64> = match (near, far) {
                (Some(near), _) => table_of::<1>(&near, 4)?.map(|[at]| u64::from(at)).collect(),
                (None, Some(far)) => table_of::<2>(&far, 4)?
                    .map(|[high, low]| u64::from(high) << 32 | u64::from(low))
                    .collect(),
                (None, None) => return None,
            };
            Tables {
                durations: table_of(&durations?, 4)?.collect(),
                sizes: sizes_of(&sizes?)?,
                chunks: table_of(&chunks?, 4)?.collect(),
                offsets,
                timescale: timescale_of(&header?)?,
            }
            .samples()
        };
        return Ok(tables());
    }
    Ok(None)
}

/// The tables that say where and when the samples of a track are.
struct Tables {
    /// Numbers of samples, and the duration of each.
    durations: Vec<[u32; 2]>,
    sizes: Vec<u32>,
    /// From which chunk on, counted from one, how many samples are in a chunk.
    chunks: Vec<[u32; 3]>,
    offsets: Vec<u64>,
    /// Units of time in a second.
    timescale: u32,
}

impl Tables {
    fn samples(&self) -> Option<Vec<Sample>> {
        let durations = self.durations.iter().flat_map(|[count, duration]| {
            std::iter::repeat_n(*duration, (*count as usize).min(self.sizes.len()))
        });
        let mut durations = durations.chain(std::iter::repeat(0));
        let mut sizes = self.sizes.iter();
        let (mut samples, mut run, mut time) = (Vec::new(), 0, 0u64);
        for (chunk, offset) in (1u32..).zip(&self.offsets) {
            while self.chunks.get(run + 1).is_some_and(|[first, ..]| *first <= chunk) {
                run += 1;
            }
            let mut at = *offset;
            for _ in 0..self.chunks.get(run)?[1] {
                let Some(size) = sizes.next() else { return Some(samples) };
                let end = at.checked_add(u64::from(*size))?;
                let next = time + u64::from(durations.next()?);
                let second = |time: u64| time as f64 / f64::from(self.timescale);
                samples.push(Sample { bytes: at..end, times_s: second(time)..second(next) });
                (at, time) = (end, next);
            }
        }
        Some(samples)
    }
}

/// The entries of `N` numbers of a table whose count is at `at`; those that are there.
fn table_of<const N: usize>(
    bytes: &[u8],
    at: usize,
) -> Option<impl Iterator<Item = [u32; N]> + use<'_, N>> {
    let count = number_at(bytes, at)? as usize;
    let entries = bytes.get(at + 4..)?.chunks_exact(4 * N).take(count);
    Some(entries.map(|entry| std::array::from_fn(|k| number_at(entry, 4 * k).unwrap_or(0))))
}

fn sizes_of(bytes: &[u8]) -> Option<Vec<u32>> {
    match number_at(bytes, 4)? {
        0 => Some(table_of::<1>(bytes, 8)?.map(|[size]| size).collect()),
        // All have one size. A damaged table may tell any number of samples.
        size => Some(vec![size; (number_at(bytes, 8)? as usize).min(MAX_LEN as usize / 4)]),
    }
}

fn timescale_of(header: &[u8]) -> Option<u32> {
    let at = if header.first()? == &1 { 20 } else { 12 };
    number_at(header, at).filter(|timescale| *timescale > 0)
}

fn number_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(*bytes.get(at..)?.first_chunk()?))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in super::super) fn mp4_box(name: &[u8; 4], content: &[u8]) -> Vec<u8> {
        [&(8 + content.len() as u32).to_be_bytes(), name.as_slice(), content].concat()
    }

    fn numbers(list: &[u32]) -> Vec<u8> {
        list.iter().flat_map(|number| number.to_be_bytes()).collect()
    }

    /// A track of samples at `offset`, one after the other, two in the first chunk, the others in
    /// the second, of `duration` thousandths of a second.
    pub(in super::super) fn track(
        format: &[u8; 4],
        sizes: &[u32],
        offset: u64,
        duration: u32,
    ) -> Vec<u8> {
        let stsd = [numbers(&[0, 1, 16]), format.to_vec(), numbers(&[0, 1])].concat();
        let count = sizes.len() as u32;
        let second = offset + u64::from(sizes[0] + sizes[1]);
        let co64 = numbers(&[
            0,
            2,
            (offset >> 32) as u32,
            offset as u32,
            (second >> 32) as u32,
            second as u32,
        ]);
        let table = [
            mp4_box(b"stsd", &stsd),
            mp4_box(b"stts", &numbers(&[0, 2, 1, duration, count - 1, duration])),
            mp4_box(b"stsz", &[numbers(&[0, 0, count]), numbers(sizes)].concat()),
            mp4_box(b"stsc", &numbers(&[0, 2, 1, 2, 1, 2, count - 2, 1])),
            mp4_box(b"co64", &co64),
        ];
        let minf = mp4_box(b"minf", &mp4_box(b"stbl", &table.concat()));
        let mdhd = mp4_box(b"mdhd", &numbers(&[0, 0, 0, 1000, 0, 0]));
        mp4_box(b"trak", &mp4_box(b"mdia", &[mdhd, minf].concat()))
    }

    #[test]
    fn samples_are_found_by_their_tables() {
        let tracks = [
            mp4_box(b"mvhd", &[0; 100]),
            track(b"avc1", &[9, 9, 9], 8, 40),
            track(b"gpmd", &[3, 5, 7, 11], 1 << 33, 1001),
        ];
        let bytes = mp4_box(b"moov", &tracks.concat());
        let found = samples(&mut io::Cursor::new(&bytes), bytes.len() as u64, b"gpmd").unwrap();
        let found = found.unwrap();
        let ranges: Vec<(u64, u64)> = found
            .iter()
            .map(|sample| (sample.bytes.start - (1 << 33), sample.bytes.end - (1 << 33)))
            .collect();
        assert_eq!(ranges, [(0, 3), (3, 8), (8, 15), (15, 26)]);
        assert_eq!(found[2].times_s, 2.002..3.003);
        let none = samples(&mut io::Cursor::new(&bytes), bytes.len() as u64, b"camm").unwrap();
        assert_eq!(none, None);
    }
}
