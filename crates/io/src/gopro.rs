//! What a GoPro says of itself in its videos: whether it stabilised the picture electronically.
//!
//! The settings lie in the box `moov/udta/GPMF` of the MP4 file (ISO/IEC 14496-12), as keys of four
//! letters, a type, the size of an element (one byte), their number (two bytes, high one first) and
//! the elements, padded to four bytes; type 0 holds further keys
//! (<https://github.com/gopro/gpmf-parser>). The key `EISE` is `Y` or `N`.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use crate::{Error, Result};

/// Settings are some hundred bytes long, those of a whole recording some thousand.
const MAX_SETTINGS_LEN: u64 = 1 << 20;
/// Containers of containers of keys; more is no settings.
const MAX_DEPTH: usize = 8;

/// Whether the camera has stabilised a video electronically; `None` where the file does not say it,
/// whatever its format.
pub fn is_stabilised(path: &Path) -> Result<Option<bool>> {
    let file = File::open(path).map_err(Error::io(path))?;
    let length = file.metadata().map_err(Error::io(path))?.len();
    let mut file = BufReader::new(file);
    Ok(settings(&mut file, length)
        .map_err(Error::io(path))?
        .and_then(|settings| stabilisation(&settings, 0)))
}

/// The bytes of `moov/udta/GPMF`.
fn settings(file: &mut (impl Read + Seek), length: u64) -> io::Result<Option<Vec<u8>>> {
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

/// Where the content of the first box of a name lies among those of a stretch of the file. What is
/// no box ends the search.
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

/// What the key `EISE` says.
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

    fn video(says: &[u8]) -> Vec<u8> {
        let settings = [key(b"DVNM", b'c', b"Camera"), key(b"EISE", b'c', says)].concat();
        let gpmf = mp4_box(b"GPMF", &key(b"DEVC", 0, &settings));
        let udta = mp4_box(b"udta", &[mp4_box(b"FIRM", b"H"), gpmf].concat());
        let moov = mp4_box(b"moov", &[mp4_box(b"mvhd", &[0; 100]), udta].concat());
        // The pictures as a box of 64-bit size.
        let mdat = [&1u32.to_be_bytes(), b"mdat".as_slice(), &(16 + 5u64).to_be_bytes(), b"frame"]
            .concat();
        [mp4_box(b"ftyp", b"mp41"), mdat, moov].concat()
    }

    fn asked(bytes: &[u8]) -> Option<bool> {
        let mut file = io::Cursor::new(bytes);
        settings(&mut file, bytes.len() as u64)
            .unwrap()
            .and_then(|settings| stabilisation(&settings, 0))
    }

    #[test]
    fn what_the_camera_says_is_found() {
        assert_eq!(asked(&video(b"Y")), Some(true));
        assert_eq!(asked(&video(b"N")), Some(false));
        assert_eq!(asked(&video(b"")), None);
        assert_eq!(asked(&mp4_box(b"ftyp", b"mp41")), None);
    }

    proptest! {
        #[test]
        fn whatever_is_in_a_file_is_no_panic(at in 0usize..400, byte: u8, end in 0usize..400) {
            let mut bytes = video(b"Y");
            bytes.truncate(end.max(1));
            let at = at % bytes.len();
            bytes[at] = byte;
            let mut file = io::Cursor::new(&bytes);
            if let Ok(Some(settings)) = settings(&mut file, bytes.len() as u64) {
                stabilisation(&settings, 0);
            }
        }
    }
}
