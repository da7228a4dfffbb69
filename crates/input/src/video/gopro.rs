//! Electronic image stabilisation of GoPro videos, as the settings in the file tell it.
//!
//! The settings are in the box `moov/udta/GPMF` of the MP4 file (ISO/IEC 14496-12). Each record has
//! a key of four letters, a type, the size of an element (one byte), the number of elements (two
//! bytes, big-endian) and the elements, padded to four bytes. A record of type 0 holds further
//! records (<https://github.com/gopro/gpmf-parser>). The key `EISE` is `Y` or `N`.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use tiepoint_io::{Error, Result};

/// Upper limit in bytes. Settings take some hundred bytes, those of a whole recording some
/// thousand.
const MAX_SETTINGS_LEN: u64 = 1 << 20;
/// Deepest nesting of records that is read.
const MAX_DEPTH: usize = 8;

/// Whether the camera stabilised a video electronically. `None` if the file does not tell, whatever
/// its format.
///
/// # Errors
///
/// [`Error::Io`] if the file cannot be read.
pub fn is_stabilised(path: &Path) -> Result<Option<bool>> {
    let file = File::open(path).map_err(Error::io(path))?;
    let length = file.metadata().map_err(Error::io(path))?.len();
    let mut file = BufReader::new(file);
    Ok(read_settings(&mut file, length)
        .map_err(Error::io(path))?
        .and_then(|settings| stabilisation(&settings, 0)))
}

/// The bytes of `moov/udta/GPMF`.
fn read_settings(file: &mut (impl Read + Seek), length: u64) -> io::Result<Option<Vec<u8>>> {
    let mut within = 0..length;
    for name in [b"moov", b"udta", b"GPMF"] {
        let Some(found) = find_box(file, within, name)? else { return Ok(None) };
        within = found;
    }
    if within.end - within.start > MAX_SETTINGS_LEN {
        return Ok(None);
    }
    file.seek(SeekFrom::Start(within.start))?;
    let mut settings = Vec::new();
    file.take(within.end - within.start).read_to_end(&mut settings)?;
    Ok(Some(settings))
}

/// The byte range of the content of the first box called `name` in the range `within`. `None` if
/// there is no such box, or if the search meets bytes that are not a box.
fn find_box(
    file: &mut (impl Read + Seek),
    within: std::ops::Range<u64>,
    name: &[u8; 4],
) -> io::Result<Option<std::ops::Range<u64>>> {
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
            return Ok(None);
        }
        if head[4..8] == *name {
            return Ok(Some(at + start..at + size));
        }
        at += size;
    }
    Ok(None)
}

/// The value of the key `EISE`: true for `Y`, false for `N`.
fn stabilisation(mut keys: &[u8], depth: usize) -> Option<bool> {
    while let Some((head, rest)) = keys.split_first_chunk::<8>() {
        let [k0, k1, k2, k3, kind, size, high, low] = *head;
        let len = usize::from(size) * usize::from(u16::from_be_bytes([high, low]));
        let content = rest.get(..len)?;
        match (&[k0, k1, k2, k3], content) {
            (b"EISE", [b'Y', ..]) => return Some(true),
            (b"EISE", [b'N', ..]) => return Some(false),
            _ => {}
        }
        if kind == 0
            && depth < MAX_DEPTH
            && let Some(found) = stabilisation(content, depth + 1)
        {
            return Some(found);
        }
        keys = rest.get(len.next_multiple_of(4)..).unwrap_or_default();
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn key(name: &[u8; 4], kind: u8, content: &[u8]) -> Vec<u8> {
        let mut bytes =
            [name.as_slice(), &[kind, 1], &(content.len() as u16).to_be_bytes(), content].concat();
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        bytes
    }

    fn mp4_box(name: &[u8; 4], content: &[u8]) -> Vec<u8> {
        [&(8 + content.len() as u32).to_be_bytes(), name.as_slice(), content].concat()
    }

    fn video(eise: &[u8]) -> Vec<u8> {
        let settings = [key(b"DVNM", b'c', b"Camera"), key(b"EISE", b'c', eise)].concat();
        let gpmf = mp4_box(b"GPMF", &key(b"DEVC", 0, &settings));
        let udta = mp4_box(b"udta", &[mp4_box(b"FIRM", b"H"), gpmf].concat());
        let moov = mp4_box(b"moov", &[mp4_box(b"mvhd", &[0; 100]), udta].concat());
        // The video frames, in a box of 64-bit size.
        let mdat = [&1u32.to_be_bytes(), b"mdat".as_slice(), &(16 + 5u64).to_be_bytes(), b"frame"]
            .concat();
        [mp4_box(b"ftyp", b"mp41"), mdat, moov].concat()
    }

    fn stabilisation_of(bytes: &[u8]) -> Option<bool> {
        let mut file = io::Cursor::new(bytes);
        read_settings(&mut file, bytes.len() as u64)
            .unwrap()
            .and_then(|settings| stabilisation(&settings, 0))
    }

    #[test]
    fn stabilisation_is_read_from_the_settings() {
        assert_eq!(stabilisation_of(&video(b"Y")), Some(true));
        assert_eq!(stabilisation_of(&video(b"N")), Some(false));
        assert_eq!(stabilisation_of(&video(b"")), None);
        assert_eq!(stabilisation_of(&mp4_box(b"ftyp", b"mp41")), None);
    }

    proptest! {
        #[test]
        fn damaged_files_do_not_panic(at in 0usize..400, byte: u8, end in 0usize..400) {
            let mut bytes = video(b"Y");
            bytes.truncate(end.max(1));
            let at = at % bytes.len();
            bytes[at] = byte;
            let mut file = io::Cursor::new(&bytes);
            if let Ok(Some(settings)) = read_settings(&mut file, bytes.len() as u64) {
                stabilisation(&settings, 0);
            }
        }
    }
}
