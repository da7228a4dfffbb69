//! Electronic image stabilisation of GoPro videos, as the settings in the file tell it.
//!
//! The settings are the records in the box `moov/udta/GPMF` of the MP4 file. That with the key
//! `EISE` is `Y` or `N`.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek};
use std::path::Path;

use tiepoint_io::{Error, Result};

use super::klv::for_each_record;
use super::mp4::{find_path, read_range};

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
        .and_then(|settings| stabilisation(&settings)))
}

/// The bytes of `moov/udta/GPMF`.
pub(super) fn read_settings(
    file: &mut (impl Read + Seek),
    length: u64,
) -> io::Result<Option<Vec<u8>>> {
    match find_path(file, 0..length, &[b"moov", b"udta", b"GPMF"])? {
        Some(range) => read_range(file, range),
        None => Ok(None),
    }
}

/// The value of the key `EISE`: true for `Y`, false for `N`.
fn stabilisation(settings: &[u8]) -> Option<bool> {
    let mut found = None;
    for_each_record(settings, 0, &mut |record| {
        let value = match (&record.key, record.content) {
            (b"EISE", [b'Y', ..]) => Some(true),
            (b"EISE", [b'N', ..]) => Some(false),
            _ => None,
        };
        found = found.or(value);
    });
    found
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::klv::tests::record;
    use super::super::mp4::tests::mp4_box;
    use super::*;

    fn video(eise: &[u8]) -> Vec<u8> {
        let settings =
            [record(b"DVNM", b'c', 1, b"Camera"), record(b"EISE", b'c', 1, eise)].concat();
        let gpmf = mp4_box(b"GPMF", &record(b"DEVC", 0, 1, &settings));
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
            .and_then(|settings| stabilisation(&settings))
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
                stabilisation(&settings);
            }
        }
    }
}
