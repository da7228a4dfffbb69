//! Fingerprints that detect changed photos without reading them completely.
//!
//! The fingerprint of a file covers its name, its size, and the BLAKE3 hash of its first and last
//! 64 KiB. Copying or touching a photo does not change it. Editing or replacing one does, because
//! the size, the header or the end of the compressed data changes. A change in the middle of a file
//! that keeps its size goes undetected.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tiepoint_store::require_regular_file;

use crate::{Error, ImageFolder};

/// Bytes hashed at each end of a file.
const END: u64 = 64 << 10;

/// Fingerprint of all images of a folder. An unreadable image has a hash of zeros.
///
/// # Errors
///
/// A file is no regular file, or cannot be read.
pub fn fingerprint(folder: &ImageFolder) -> Result<String, Error> {
    let hashes: Vec<[u8; 32]> = (0..folder.images().len())
        .into_par_iter()
        .map(|index| hash_ends(folder.path(index)).unwrap_or_default())
        .collect();
    let mut all = blake3::Hasher::new();
    for (image, hash) in folder.images().iter().zip(hashes) {
        all.update(&(image.name.len() as u64).to_le_bytes())
            .update(image.name.as_bytes())
            .update(&hash);
    }
    Ok(all.finalize().to_hex().to_string())
}

/// Fingerprint of one image file.
///
/// # Errors
///
/// A file is no regular file, or cannot be read.
pub fn of_photo(path: &Path) -> io::Result<String> {
    Ok(blake3::Hash::from_bytes(hash_ends(path)?).to_hex().to_string())
}

/// Fingerprint of a small file, of its whole content.
///
/// # Errors
///
/// A file is no regular file, or cannot be read.
pub fn hash_file(path: &Path) -> Result<String, Error> {
    require_regular_file(path)?;
    let bytes = std::fs::read(path).map_err(tiepoint_store::Error::unreadable(path))?;
    Ok(hash_bytes(&bytes))
}

/// Fingerprint of a text.
pub fn hash_bytes(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// Fingerprint of a list of files, without their names.
///
/// # Errors
///
/// A file is no regular file, or cannot be read.
pub fn hash_file_ends(paths: &[PathBuf]) -> Result<String, Error> {
    let mut all = blake3::Hasher::new();
    for path in paths {
        require_regular_file(path)?;
        all.update(&hash_ends(path).map_err(tiepoint_store::Error::unreadable(path))?);
    }
    Ok(all.finalize().to_hex().to_string())
}

/// Fingerprint of a list of files, of their whole contents, without their names.
///
/// # Errors
///
/// A file is no regular file, or cannot be read.
pub fn hash_files(paths: &[PathBuf]) -> Result<String, Error> {
    let mut all = blake3::Hasher::new();
    for path in paths {
        require_regular_file(path)?;
        let hash = hash_contents(path);
        all.update(&hash.map_err(tiepoint_store::Error::unreadable(path))?);
    }
    Ok(all.finalize().to_hex().to_string())
}

fn hash_contents(path: &Path) -> io::Result<[u8; 32]> {
    let mut file = File::open(path)?;
    let mut hash = blake3::Hasher::new();
    let mut buffer = vec![0; END as usize];
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok(*hash.finalize().as_bytes()),
            length => hash.update(&buffer[..length]),
        };
    }
}

fn hash_ends(path: &Path) -> io::Result<[u8; 32]> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut ends = Vec::new();
    file.by_ref().take(END).read_to_end(&mut ends)?;
    if length > END {
        file.seek(SeekFrom::Start(END.max(length.saturating_sub(END))))?;
        file.take(END).read_to_end(&mut ends)?;
    }
    let mut hash = blake3::Hasher::new();
    Ok(*hash.update(&length.to_le_bytes()).update(&ends).finalize().as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_fingerprint_depends_on_length_and_ends() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.jpg");
        let of = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            hash_ends(&path).unwrap()
        };
        for length in [0, 1, END as usize, END as usize + 1, 3 * END as usize] {
            let bytes = vec![7; length];
            let hash = of(&bytes);
            assert_eq!(hash, of(&bytes), "written again");
            assert_ne!(hash, of(&[bytes.as_slice(), &[7]].concat()), "one byte more");
            for changed in [0, length.saturating_sub(1)].into_iter().filter(|at| *at < length) {
                let mut other = bytes.clone();
                other[changed] = 8;
                assert_ne!(hash, of(&other), "byte {changed} of {length}");
            }
        }
    }

    #[test]
    fn folder_fingerprint_depends_on_names() {
        let dir = tempfile::tempdir().unwrap();
        let of =
            || fingerprint(&ImageFolder::open(&[dir.path().to_owned()], None).unwrap()).unwrap();
        std::fs::write(dir.path().join("a.jpg"), "a").unwrap();
        let one = of();
        std::fs::rename(dir.path().join("a.jpg"), dir.path().join("b.jpg")).unwrap();
        assert_ne!(one, of());
    }
}
