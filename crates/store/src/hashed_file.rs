//! Files that end with the hash of what is before it, for results that other processes read.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::PathBuf;

use crate::disk::Folder;
use crate::{AtomicFile, Error, Result};

const HASH_BYTES: usize = 32;
/// Size of read buffers.
const BUFFER_BYTES: usize = 1 << 16;

/// A file that gets its hash and its name in [`HashedFile::commit`]; dropped earlier, it leaves
/// nothing behind. [`open_hashed`] reads it.
#[derive(Debug)]
pub struct HashedFile {
    file: AtomicFile,
    hash: blake3::Hasher,
}

impl HashedFile {
    /// Begins to write a file of a folder; its own folder must exist.
    ///
    /// # Errors
    ///
    /// If a part of the name is a link, if what has the name is no regular file, and those of
    /// [`AtomicFile::create`].
    pub fn create(folder: &Folder, name: &str) -> Result<Self> {
        let path = folder.join(name);
        if let Some(path) = folder.find_link(name).map_err(Error::output(&path))? {
            return Err(Error::LinkInFolder { path });
        }
        if is_file(folder, name).map_err(Error::output(&path))? == Some(false) {
            return Err(Error::ForeignFile { path });
        }
        Ok(Self { file: AtomicFile::create(path)?, hash: blake3::Hasher::new() })
    }

    /// Writes the hash, and gives the file its name.
    ///
    /// # Errors
    ///
    /// Those of [`AtomicFile::commit`].
    pub fn commit(mut self) -> Result<()> {
        let path: PathBuf = self.file.path().to_owned();
        self.file.write_all(self.hash.finalize().as_bytes()).map_err(Error::io(&path))?;
        self.file.commit()
    }
}

impl Write for HashedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write(bytes)?;
        self.hash.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// Opens a file that [`HashedFile`] wrote: the file at its begin, and the number of bytes before
/// the hash. `None` if the content does not have this hash.
///
/// # Errors
///
/// If a part of the name is a link, if there is no such file, if it is no regular file, or it
/// cannot be read.
pub fn open_hashed(folder: &Folder, name: &str) -> Result<Option<(File, u64)>> {
    let Some((mut file, length)) = open_unchecked(folder, name)? else { return Ok(None) };
    let path = folder.join(name);
    let failed = || Error::unreadable(&path);
    let (mut hash, mut buffer) = (blake3::Hasher::new(), vec![0; BUFFER_BYTES]);
    let mut content = Read::by_ref(&mut file).take(length);
    loop {
        match content.read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => drop(hash.update(&buffer[..count])),
            Err(cause) if cause.kind() == io::ErrorKind::Interrupted => continue,
            Err(cause) => return Err(failed()(cause)),
        }
    }
    let mut written = [0; HASH_BYTES];
    file.read_exact(&mut written).map_err(failed())?;
    file.seek(SeekFrom::Start(0)).map_err(failed())?;
    Ok((hash.finalize() == written).then_some((file, length)))
}

/// As [`open_hashed`], without reading the content: for a file that was checked before, and for the
/// begin of one. `None` if it is shorter than a hash.
///
/// # Errors
///
/// Those of [`open_hashed`].
pub fn open_unchecked(folder: &Folder, name: &str) -> Result<Option<(File, u64)>> {
    let path = folder.join(name);
    let failed = || Error::unreadable(&path);
    if let Some(path) = folder.find_link(name).map_err(failed())? {
        return Err(Error::LinkInFolder { path });
    }
    match is_file(folder, name).map_err(failed())? {
        None => return Err(failed()(io::ErrorKind::NotFound.into())),
        Some(false) => return Err(Error::ForeignFile { path }),
        Some(true) => {}
    }
    let file = folder.open_file(name).map_err(failed())?;
    let length = file.metadata().map_err(failed())?.len();
    Ok(length.checked_sub(HASH_BYTES as u64).map(|length| (file, length)))
}

/// Whether what has a name is a regular file; `None` if nothing has it. A named pipe would block
/// until another process opens it.
fn is_file(folder: &Folder, name: &str) -> io::Result<Option<bool>> {
    Ok(folder.metadata(name)?.map(|found| found.is_file()))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_changed_byte_is_found() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::open(dir.path()).unwrap();
        let mut file = HashedFile::create(&folder, "a").unwrap();
        file.write_all(b"some content").unwrap();
        assert!(!dir.path().join("a").exists(), "no name before the commit");
        file.commit().unwrap();
        let (file, length) = open_hashed(&folder, "a").unwrap().unwrap();
        let mut content = String::new();
        file.take(length).read_to_string(&mut content).unwrap();
        assert_eq!(content, "some content");
        let good = fs::read(dir.path().join("a")).unwrap();
        for change in [0, 5, good.len() - 1] {
            let mut bad = good.clone();
            bad[change] ^= 1;
            fs::write(dir.path().join("a"), bad).unwrap();
            assert!(open_hashed(&folder, "a").unwrap().is_none());
            assert_eq!(open_unchecked(&folder, "a").unwrap().unwrap().1, length);
        }
        fs::write(dir.path().join("a"), &good[..20]).unwrap();
        assert!(open_hashed(&folder, "a").unwrap().is_none());
        fs::write(dir.path().join("a"), &good[..HASH_BYTES - 1]).unwrap();
        assert!(open_unchecked(&folder, "a").unwrap().is_none());
        assert!(open_hashed(&folder, "b").is_err());
    }

    #[cfg(unix)]
    #[test]
    fn no_link_is_followed() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("mine"), "mine").unwrap();
        std::os::unix::fs::symlink("mine", dir.path().join("a")).unwrap();
        let folder = Folder::open(dir.path()).unwrap();
        assert!(matches!(HashedFile::create(&folder, "a"), Err(Error::LinkInFolder { .. })));
        assert!(matches!(open_unchecked(&folder, "a"), Err(Error::LinkInFolder { .. })));
    }

    #[cfg(unix)]
    #[test]
    fn no_folder_and_no_pipe_is_opened() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("folder")).unwrap();
        let pipe = dir.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(pipe).status().unwrap().success());
        let folder = Folder::open(dir.path()).unwrap();
        for name in ["folder", "pipe"] {
            assert!(matches!(HashedFile::create(&folder, name), Err(Error::ForeignFile { .. })));
            assert!(matches!(open_unchecked(&folder, name), Err(Error::ForeignFile { .. })));
        }
    }
}
