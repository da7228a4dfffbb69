//! Atomic replacement of files: written under a temporary name in the same folder, synchronised to
//! the disk, renamed.

use std::fs::{self, File, Metadata, OpenOptions, TryLockError};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::disk::{self, WrittenFile, end_of_links, temporary_path};
use crate::{Error, Result};

/// Paths below these folders lead to open files of processes, which cannot be replaced.
const OPEN_FILE_FOLDERS: [&str; 4] = ["/dev/fd", "/dev/stdin", "/dev/stdout", "/proc"];

/// A file that gets its name in [`AtomicFile::commit`]; dropped earlier, it leaves nothing behind.
///
/// Symbolic links to files are followed. A file that replaces another takes over its mode and, if
/// the system permits it, its owner. Devices and pipes are written directly. A temporary file of a
/// killed run is removed.
#[derive(Debug)]
pub struct AtomicFile {
    /// The path as the caller gave it.
    path: PathBuf,
    /// `None` for a device or pipe, which is written directly.
    replacement: Option<Replacement>,
    /// `None` after the commit.
    writer: Option<BufWriter<WrittenFile>>,
}

/// A replacement in progress.
#[derive(Debug)]
struct Replacement {
    /// The path at the end of the symbolic links.
    target: PathBuf,
    temporary: PathBuf,
    /// Metadata of the file that is replaced.
    old_metadata: Option<Metadata>,
}

impl AtomicFile {
    /// Begins to write `path`; its folder must exist.
    ///
    /// # Errors
    ///
    /// If `path` is a folder or a block device, if another run is writing it, and if the system
    /// reports an error.
    pub fn create(path: impl Into<PathBuf>) -> Result<Self> {
        let path = path.into();
        if path.file_name().is_none() {
            return Err(Error::content(&path, "is not the name of a file"));
        }
        let target = end_of_links(&path).map_err(Error::io(&path))?;
        let old_metadata = match fs::metadata(&path) {
            Ok(found) => Some(found),
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => None,
            Err(cause) => return Err(Error::Io { path, cause }),
        };
        if old_metadata.as_ref().is_some_and(Metadata::is_dir) {
            return Err(Error::content(&path, "is a folder, and a file was to be written"));
        }
        if old_metadata.as_ref().is_some_and(is_block_device) {
            return Err(Error::content(
                &path,
                "is a block device: writing to it would destroy its content",
            ));
        }
        let is_special = old_metadata.as_ref().is_some_and(|found| !found.is_file());
        let is_open_file = old_metadata.is_some()
            && OPEN_FILE_FOLDERS.iter().any(|folder| path.starts_with(folder));
        if is_special || is_open_file {
            let writer =
                BufWriter::new(WrittenFile::open_special(&path).map_err(Error::io(&path))?);
            return Ok(Self { path, replacement: None, writer: Some(writer) });
        }
        let temporary = temporary_path(&target);
        let file = create_temporary(&path, &temporary)?;
        let replacement = Some(Replacement { target, temporary, old_metadata });
        Ok(Self { path, replacement, writer: Some(BufWriter::new(file)) })
    }

    /// Writes a whole file; `content` writes into a buffer.
    ///
    /// # Errors
    ///
    /// The errors of [`AtomicFile::create`], of `content` and of [`AtomicFile::commit`].
    pub fn write_with(
        path: impl Into<PathBuf>,
        content: impl FnOnce(&mut Self) -> io::Result<()>,
    ) -> Result<()> {
        let mut file = Self::create(path)?;
        content(&mut file).map_err(Error::io(&file.path.clone()))?;
        file.commit()
    }

    /// The final path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Synchronises the content to the disk and renames the file to its path, replacing the file
    /// there.
    ///
    /// # Errors
    ///
    /// If the system reports an error; a file at the path is then unchanged.
    pub fn commit(mut self) -> Result<()> {
        let Some(writer) = self.writer.take() else { return Ok(()) };
        let file = writer.into_inner().map_err(io::IntoInnerError::into_error);
        let committed = match (&self.replacement, file) {
            (None, file) => file.map(drop),
            (Some(replacement), file) => file.and_then(|file| replacement.replace(file)),
        };
        committed.map_err(|cause| {
            self.remove_temporary();
            Error::Io { path: self.path.clone(), cause }
        })
    }

    fn remove_temporary(&self) {
        if let Some(Replacement { temporary, .. }) = &self.replacement {
            // An earlier error is the one to report.
            let _ = disk::remove_file(temporary);
        }
    }
}

impl Replacement {
    fn replace(&self, file: WrittenFile) -> io::Result<()> {
        if let Some(old_metadata) = &self.old_metadata {
            copy_mode_and_owner(old_metadata, file.file())?;
        }
        file.sync()?;
        // The lock protects the temporary name until the rename; Windows cannot rename an open
        // file.
        let open = if cfg!(windows) { None } else { Some(file) };
        disk::rename(&self.temporary, &self.target)?;
        drop(open);
        disk::sync_folder(disk::folder_of(&self.target))
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.as_mut().map_or(Ok(0), |writer| writer.write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.as_mut().map_or(Ok(()), Write::flush)
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        if let Some(writer) = self.writer.take() {
            // Discards the buffer without writing it.
            drop(writer.into_parts());
            self.remove_temporary();
        }
    }
}

/// Creates and locks the temporary file. An existing one without a lock was left by a killed run
/// and is replaced.
fn create_temporary(path: &Path, temporary: &Path) -> Result<WrittenFile> {
    let busy = || Error::content(path, "is being written by another run: wait for it to end");
    let create = || -> io::Result<WrittenFile> {
        let file = WrittenFile::create_new(temporary)?;
        // File systems without locks are accepted.
        let _ = file.file().try_lock();
        Ok(file)
    };
    match create() {
        Err(cause) if cause.kind() == io::ErrorKind::AlreadyExists => {}
        made => return made.map_err(Error::io(path)),
    }
    let found = fs::symlink_metadata(temporary).map_err(Error::io(path))?;
    if !found.is_file() {
        return Err(Error::content(temporary, "is in the way: move it away"));
    }
    let left = OpenOptions::new().write(true).open(temporary).map_err(Error::io(path))?;
    if let Err(TryLockError::WouldBlock) = left.try_lock() {
        return Err(busy());
    }
    disk::remove_file(temporary).map_err(Error::io(path))?;
    match create() {
        Err(cause) if cause.kind() == io::ErrorKind::AlreadyExists => Err(busy()),
        made => made.map_err(Error::io(path)),
    }
}

#[cfg(unix)]
fn is_block_device(found: &Metadata) -> bool {
    std::os::unix::fs::FileTypeExt::is_block_device(&found.file_type())
}

#[cfg(not(unix))]
fn is_block_device(_: &Metadata) -> bool {
    false
}

/// Copies the mode of the replaced file, and its owner and group if that is permitted.
fn copy_mode_and_owner(old_metadata: &Metadata, file: &File) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, fchown};
        let own = file.metadata()?;
        if (own.uid(), own.gid()) != (old_metadata.uid(), old_metadata.gid())
            && fchown(file, Some(old_metadata.uid()), Some(old_metadata.gid())).is_err()
        {
            // Only root may change the owner; changing the group is often permitted.
            let _ = fchown(file, None, Some(old_metadata.gid()));
        }
    }
    file.set_permissions(old_metadata.permissions())
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};

    use super::*;

    fn write(path: &Path, text: &str) -> Result<()> {
        AtomicFile::write_with(path, |file| file.write_all(text.as_bytes()))
    }

    fn names(dir: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(dir)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn links_are_followed_and_mode_and_owner_are_kept() {
        let dir = tempfile::tempdir().unwrap();
        let (file, link) = (dir.path().join("file"), dir.path().join("link"));
        fs::write(&file, "old").unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
        // As root this changes the owner; another user owns the file already.
        let _ = std::os::unix::fs::chown(&file, Some(12_345), Some(54_321));
        let owner = |path: &Path| {
            fs::metadata(path).map(|m| (m.uid(), m.gid(), m.mode() & 0o7777)).unwrap()
        };
        let old_metadata = owner(&file);
        symlink("file", &link).unwrap();
        write(&link, "new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert_eq!(owner(&file), old_metadata);
        // A link to a file that does not exist, and links that form a cycle.
        symlink("later", dir.path().join("early")).unwrap();
        let refused = write(&dir.path().join("early"), "now").unwrap_err().to_string();
        assert!(refused.contains("early: is a symbolic link to nothing"), "{refused}");
        symlink("b", dir.path().join("a")).unwrap();
        symlink("a", dir.path().join("b")).unwrap();
        assert!(write(&dir.path().join("a"), "").unwrap_err().to_string().contains("each other"));
        assert_eq!(names(dir.path()), ["a", "b", "early", "file", "link"]);
    }

    #[test]
    fn devices_and_pipes_are_written_to() {
        let dir = tempfile::tempdir().unwrap();
        let old_metadata = fs::metadata("/dev/null").map(|m| (m.ino(), m.mode())).unwrap();
        write(Path::new("/dev/null"), "gone").unwrap();
        assert_eq!(fs::metadata("/dev/null").map(|m| (m.ino(), m.mode())).unwrap(), old_metadata);
        assert!(
            write(Path::new("/dev/full"), "too much").unwrap_err().to_string().contains("No space")
        );
        let pipe = dir.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let reader = {
            let pipe = pipe.clone();
            std::thread::spawn(move || fs::read(pipe).unwrap())
        };
        write(&pipe, "through").unwrap();
        assert_eq!(reader.join().unwrap(), b"through");
        assert_eq!(names(dir.path()), ["pipe"]);
        #[cfg(target_os = "linux")]
        {
            // As /dev/stdout before `|`. The link names no path: `pipe:[123]`.
            let (mut reader, writer) = io::pipe().unwrap();
            let fd = std::os::fd::AsRawFd::as_raw_fd(&writer);
            write(&PathBuf::from(format!("/proc/self/fd/{fd}")), "on").unwrap();
            drop(writer);
            assert_eq!(io::read_to_string(&mut reader).unwrap(), "on");
        }
        assert!(write(dir.path(), "").unwrap_err().to_string().contains("is a folder"));
    }

    #[test]
    fn temporary_files_of_killed_runs_are_replaced_and_locked_ones_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("file");
        fs::write(temporary_path(&path), "half of it, and more than is written now").unwrap();
        write(&path, "all").unwrap();
        assert_eq!(
            (fs::read(&path).unwrap(), names(dir.path())),
            (b"all".to_vec(), vec!["file".to_owned()])
        );
        let first = AtomicFile::create(&path).unwrap();
        assert!(write(&path, "second").unwrap_err().to_string().contains("another run"));
        drop(first);
        write(&path, "second").unwrap();
        // A link under the temporary name was not made by this program.
        fs::write(dir.path().join("mine"), "mine").unwrap();
        symlink("mine", temporary_path(&path)).unwrap();
        assert!(write(&path, "third").unwrap_err().to_string().contains("in the way"));
        assert_eq!(fs::read(dir.path().join("mine")).unwrap(), b"mine");
    }

    #[test]
    fn names_of_255_bytes_are_written() {
        let dir = tempfile::tempdir().unwrap();
        for last in ["a", "b"] {
            let path = dir.path().join("ä".repeat(127) + last);
            write(&path, last).unwrap();
            assert_eq!(fs::read(&path).unwrap(), last.as_bytes());
        }
        assert_eq!(names(dir.path()).len(), 2);
    }
}
