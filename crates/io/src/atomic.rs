//! Files that are there complete or not at all: written under another name in the same folder,
//! brought to the disk, renamed.

use std::fs::{self, File, Metadata, OpenOptions, TryLockError};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::disk::{self, WrittenFile, end_of_links, part_of};
use crate::{Error, Result};

/// Below these folders, paths lead to open files of processes, which cannot be replaced.
const WRITTEN_THROUGH: [&str; 4] = ["/dev/fd", "/dev/stdin", "/dev/stdout", "/proc"];

/// A file that takes its name with [`AtomicFile::commit`]; dropped before, it leaves nothing
/// behind.
///
/// Symbolic links are followed; a file that is replaced hands on its mode and, where the system
/// permits it, its owner. Devices and pipes are written to as they are. What a killed run left
/// under the temporary name goes with the next one.
#[derive(Debug)]
pub struct AtomicFile {
    /// As given.
    path: PathBuf,
    /// `None` where it is written through.
    replaced: Option<Replaced>,
    /// `None` once committed.
    writer: Option<BufWriter<WrittenFile>>,
}

/// The way to replace a file.
#[derive(Debug)]
struct Replaced {
    /// Where links end.
    target: PathBuf,
    temporary: PathBuf,
    /// Of the file that is there.
    before: Option<Metadata>,
}

impl AtomicFile {
    /// Starts to write `path`; its folder must exist.
    ///
    /// # Errors
    ///
    /// Where `path` is a folder or a disk, where another run is writing it, and where the system
    /// refuses.
    pub fn create(path: impl Into<PathBuf>) -> Result<Self> {
        let path = path.into();
        if path.file_name().is_none() {
            return Err(Error::content(&path, "is not the name of a file"));
        }
        let target = end_of_links(&path).map_err(Error::io(&path))?;
        let before = match fs::metadata(&target) {
            Ok(found) => Some(found),
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => None,
            Err(cause) => return Err(Error::Io { path, cause }),
        };
        if before.as_ref().is_some_and(Metadata::is_dir) {
            return Err(Error::content(&path, "is a folder, and a file was to be written"));
        }
        if before.as_ref().is_some_and(is_disk) {
            return Err(Error::content(&path, "is a disk, which would lose all it holds"));
        }
        let is_special = before.as_ref().is_some_and(|found| !found.is_file());
        let is_open_file =
            before.is_some() && WRITTEN_THROUGH.iter().any(|folder| path.starts_with(folder));
        if is_special || is_open_file {
            let writer =
                BufWriter::new(WrittenFile::open_special(&path).map_err(Error::io(&path))?);
            return Ok(Self { path, replaced: None, writer: Some(writer) });
        }
        let temporary = part_of(&target);
        let file = claim(&path, &temporary)?;
        let replaced = Some(Replaced { target, temporary, before });
        Ok(Self { path, replaced, writer: Some(BufWriter::new(file)) })
    }

    /// Writes a whole file: `content` gets a buffered writer.
    ///
    /// # Errors
    ///
    /// Those of [`AtomicFile::create`] and [`AtomicFile::commit`], and of `content`.
    pub fn write_with(
        path: impl Into<PathBuf>,
        content: impl FnOnce(&mut Self) -> io::Result<()>,
    ) -> Result<()> {
        let mut file = Self::create(path)?;
        content(&mut file).map_err(Error::io(&file.path.clone()))?;
        file.commit()
    }

    /// Where it will be.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Brings the content to the disk and gives the file its name, replacing what had it before.
    ///
    /// # Errors
    ///
    /// Where the system refuses; then what had the name before is as it was.
    pub fn commit(mut self) -> Result<()> {
        let Some(writer) = self.writer.take() else { return Ok(()) };
        let file = writer.into_inner().map_err(io::IntoInnerError::into_error);
        let finished = match (&self.replaced, file) {
            (None, file) => file.map(drop),
            (Some(replaced), file) => file.and_then(|file| replaced.finish(file)),
        };
        finished.map_err(|cause| {
            self.remove_temporary();
            Error::Io { path: self.path.clone(), cause }
        })
    }

    fn remove_temporary(&self) {
        if let Some(Replaced { temporary, .. }) = &self.replaced {
            // The first error is the one to report, or nobody is left to tell.
            let _ = disk::remove_file(temporary);
        }
    }
}

impl Replaced {
    fn finish(&self, file: WrittenFile) -> io::Result<()> {
        if let Some(before) = &self.before {
            hand_on(before, file.file())?;
        }
        file.sync()?;
        // The lock on the file guards its temporary name; Windows renames no file that is open.
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
            // What is in the buffer is not wanted any more.
            drop(writer.into_parts());
            self.remove_temporary();
        }
    }
}

/// Makes the temporary file and locks it. One that is there and not locked was left by a run that
/// was killed.
fn claim(path: &Path, temporary: &Path) -> Result<WrittenFile> {
    let busy = || Error::content(path, "is being written by another run: wait for it to end");
    let create = || -> io::Result<WrittenFile> {
        let file = WrittenFile::create_new(temporary)?;
        // Systems without locks go without.
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
fn is_disk(found: &Metadata) -> bool {
    std::os::unix::fs::FileTypeExt::is_block_device(&found.file_type())
}

#[cfg(not(unix))]
fn is_disk(_: &Metadata) -> bool {
    false
}

/// Gives a file the mode of the one that it replaces, and its owner and group where that is
/// allowed.
fn hand_on(before: &Metadata, file: &File) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, fchown};
        let own = file.metadata()?;
        if (own.uid(), own.gid()) != (before.uid(), before.gid())
            && fchown(file, Some(before.uid()), Some(before.gid())).is_err()
        {
            // Only root gives files away; the group is often possible.
            let _ = fchown(file, None, Some(before.gid()));
        }
    }
    file.set_permissions(before.permissions())
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
    fn links_are_followed_and_mode_and_owner_stay() {
        let dir = tempfile::tempdir().unwrap();
        let (file, link) = (dir.path().join("file"), dir.path().join("link"));
        fs::write(&file, "old").unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
        // As root this changes the owner; for others it is their own file already.
        let _ = std::os::unix::fs::chown(&file, Some(12_345), Some(54_321));
        let owner = |path: &Path| {
            fs::metadata(path).map(|m| (m.uid(), m.gid(), m.mode() & 0o7777)).unwrap()
        };
        let before = owner(&file);
        symlink("file", &link).unwrap();
        write(&link, "new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert_eq!(owner(&file), before);
        // A link to a file that is not there yet, and links that lead nowhere.
        symlink("later", dir.path().join("early")).unwrap();
        write(&dir.path().join("early"), "now").unwrap();
        assert_eq!(fs::read(dir.path().join("later")).unwrap(), b"now");
        symlink("b", dir.path().join("a")).unwrap();
        symlink("a", dir.path().join("b")).unwrap();
        assert!(write(&dir.path().join("a"), "").unwrap_err().to_string().contains("each other"));
        assert_eq!(names(dir.path()), ["a", "b", "early", "file", "later", "link"]);
    }

    #[test]
    fn devices_and_pipes_are_written_to() {
        let dir = tempfile::tempdir().unwrap();
        let before = fs::metadata("/dev/null").map(|m| (m.ino(), m.mode())).unwrap();
        write(Path::new("/dev/null"), "gone").unwrap();
        assert_eq!(fs::metadata("/dev/null").map(|m| (m.ino(), m.mode())).unwrap(), before);
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
        assert!(write(dir.path(), "").unwrap_err().to_string().contains("is a folder"));
    }

    #[test]
    fn what_a_killed_run_left_goes_and_a_running_one_is_waited_for() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("file");
        fs::write(part_of(&path), "half of it, and more than is written now").unwrap();
        write(&path, "all").unwrap();
        assert_eq!(
            (fs::read(&path).unwrap(), names(dir.path())),
            (b"all".to_vec(), vec!["file".to_owned()])
        );
        let first = AtomicFile::create(&path).unwrap();
        assert!(write(&path, "second").unwrap_err().to_string().contains("another run"));
        drop(first);
        write(&path, "second").unwrap();
        // A link of that name is nothing that this program made.
        fs::write(dir.path().join("mine"), "mine").unwrap();
        symlink("mine", part_of(&path)).unwrap();
        assert!(write(&path, "third").unwrap_err().to_string().contains("in the way"));
        assert_eq!(fs::read(dir.path().join("mine")).unwrap(), b"mine");
    }

    #[test]
    fn names_may_be_as_long_as_the_system_permits() {
        let dir = tempfile::tempdir().unwrap();
        for last in ["a", "b"] {
            let path = dir.path().join("ä".repeat(127) + last);
            write(&path, last).unwrap();
            assert_eq!(fs::read(&path).unwrap(), last.as_bytes());
        }
        assert_eq!(names(dir.path()).len(), 2);
    }
}
