//! The sizes of the pages of a TIFF file, of which decoders read the first.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Most pages that are looked at: a file may name its pages in a circle.
const MAX_PAGES: usize = 16;
const WIDTH: u16 = 256;
const HEIGHT: u16 = 257;

/// Width and height of each page. Empty if the file is no TIFF file of up to 4 GB or is broken: its
/// decoder says why.
pub(super) fn sizes(path: &Path) -> Vec<[u32; 2]> {
    File::open(path).map_or_else(|_| Vec::new(), |file| sizes_in(&mut BufReader::new(file)))
}

fn sizes_in(file: &mut (impl Read + Seek)) -> Vec<[u32; 2]> {
    let mut found = Vec::new();
    let mut next = || -> Option<()> {
        let is_little = match bytes::<4>(file)? {
            [b'I', b'I', 42, 0] => true,
            [b'M', b'M', 0, 42] => false,
            _ => return None,
        };
        let short =
            |bytes| if is_little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) };
        let long =
            |bytes| if is_little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) };
        while found.len() < MAX_PAGES {
            let at = long(bytes(file)?);
            if at == 0 {
                break;
            }
            file.seek(SeekFrom::Start(u64::from(at))).ok()?;
            let mut size = [0; 2];
            for _ in 0..short(bytes(file)?) {
                let [a, b, c, d, _, _, _, _, value @ ..] = bytes::<12>(file)?;
                let value = match short([c, d]) {
                    3 => u32::from(short([value[0], value[1]])),
                    _ => long(value),
                };
                match short([a, b]) {
                    WIDTH => size[0] = value,
                    HEIGHT => size[1] = value,
                    _ => {}
                }
            }
            found.push(size);
        }
        Some(())
    };
    next();
    found
}

fn bytes<const N: usize>(file: &mut impl Read) -> Option<[u8; N]> {
    let mut bytes = [0; N];
    file.read_exact(&mut bytes).ok().map(|()| bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file with pages of these sizes, without pixels; the last one names `end` as the next.
    fn file(sizes: &[[u32; 2]], end: u32) -> Vec<u8> {
        let mut file = b"MM\0\x2a\0\0\0\x08".to_vec();
        for (page, [width, height]) in sizes.iter().enumerate() {
            file.extend([0, 2]);
            // The width as a short, the height as a long.
            file.extend([1, 0, 0, 3, 0, 0, 0, 1]);
            file.extend((*width as u16).to_be_bytes());
            file.extend([0, 0]);
            file.extend([1, 1, 0, 4, 0, 0, 0, 1]);
            file.extend(height.to_be_bytes());
            let next = if page + 1 < sizes.len() { file.len() as u32 + 4 } else { end };
            file.extend(next.to_be_bytes());
        }
        file
    }

    #[test]
    fn pages_are_read_in_their_order_and_circles_end() {
        let pages = [[160, 107], [768, 512]];
        let read = |bytes: &[u8]| sizes_in(&mut std::io::Cursor::new(bytes));
        assert_eq!(read(&file(&pages, 0)), pages);
        assert_eq!(read(&file(&pages, 8)).len(), MAX_PAGES);
        let whole = file(&pages, 0);
        assert_eq!(read(&whole[..whole.len() - 5]), pages[..1]);
        assert!(read(b"II*").is_empty() && read(b"\x89PNG\r\n\x1a\n").is_empty());
    }
}
