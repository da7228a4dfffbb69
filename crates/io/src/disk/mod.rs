//! Every change of a file system that the workspace makes: the few functions through which all
//! writers go.
//!
//! With the feature `faults`, each call is counted and can be made to fail (module `faults`); that
//! is for tests only.

#[cfg(feature = "faults")]
pub mod faults;
#[cfg(all(feature = "faults", feature = "database"))]
pub(crate) mod faulty_vfs;

mod operation;
mod paths;

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

pub use operation::Operation;
pub use paths::folder_of;

/// Ends the name of a file or folder that is being written.
const PART: &str = ".tiepoint-part";
/// Bytes of a name that are kept in the name of its part; names of files have 255 bytes at most.
const MAX_NAME_BYTES: usize = 200;
/// Links are followed so far, as Linux does.
const MAX_LINKS: usize = 40;

/// How long a change is tried again, and how long between: scanners of Windows have a new file open
/// for so long.
const PATIENCE: Duration = Duration::from_secs(2);
const PAUSE: Duration = Duration::from_millis(10);

/// Makes a change that somebody may hold up who has the file, or one in the folder, open: on
/// Windows such a file can be neither renamed nor removed, nor the folder that it is in.
fn patiently<T>(is_held_up: bool, mut change: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    let start = Instant::now();
    loop {
        match change() {
            Err(cause)
                if is_held_up
                    && cause.kind() == io::ErrorKind::PermissionDenied
                    && start.elapsed() < PATIENCE =>
            {
                thread::sleep(PAUSE);
            }
            done => return done,
        }
    }
}

/// Called before each change.
#[cfg_attr(
    not(feature = "faults"),
    expect(clippy::unnecessary_wraps, reason = "only tests make it fail")
)]
#[inline]
pub(crate) fn before(operation: Operation, path: &Path) -> io::Result<()> {
    #[cfg(feature = "faults")]
    faults::before(operation, path)?;
    #[cfg(not(feature = "faults"))]
    let _ = (operation, path);
    Ok(())
}

/// A file that is being written.
#[derive(Debug)]
pub struct WrittenFile {
    file: File,
    path: PathBuf,
}

impl WrittenFile {
    /// Makes a new file; that there is none yet is part of the call.
    ///
    /// # Errors
    ///
    /// Where something of that name is there, and where the system refuses.
    pub fn create_new(path: &Path) -> io::Result<Self> {
        before(Operation::Create, path)?;
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        Ok(Self { file, path: path.to_owned() })
    }

    /// Opens what is there and no regular file: a device, or a pipe.
    pub(crate) fn open_special(path: &Path) -> io::Result<Self> {
        let file = OpenOptions::new().write(true).open(path)?;
        Ok(Self { file, path: path.to_owned() })
    }

    /// The open file.
    pub(crate) fn file(&self) -> &File {
        &self.file
    }

    /// Waits until the content is on the disk.
    ///
    /// # Errors
    ///
    /// Where the system refuses.
    pub fn sync(&self) -> io::Result<()> {
        before(Operation::Sync, &self.path)?;
        self.file.sync_all()
    }
}

impl Write for WrittenFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        #[cfg(feature = "faults")]
        if let Err(error) = before(Operation::Write, &self.path) {
            // A write that is cut off leaves a part.
            let _ = self.file.write(&bytes[..faults::torn(&self.path, bytes.len())]);
            return Err(error);
        }
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// Writes a new file and waits until it is on the disk.
///
/// # Errors
///
/// Where something of that name is there, and where the system refuses.
pub fn write_new(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = WrittenFile::create_new(path)?;
    file.write_all(bytes)?;
    file.sync()
}

/// Copies a file to a new one, and waits until it is on the disk.
///
/// # Errors
///
/// Where something is at `to`, and where the system refuses.
pub fn copy_new(from: &Path, to: &Path) -> io::Result<()> {
    let mut source = File::open(from)?;
    let mut file = WrittenFile::create_new(to)?;
    io::copy(&mut source, &mut file)?;
    file.sync()
}

/// Gives a file or folder another name; a file of that name is replaced. Call [`sync_folder`] for
/// it to last.
///
/// # Errors
///
/// Where the system refuses.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    before(Operation::Rename, to)?;
    patiently(cfg!(windows), || fs::rename(from, to))
}

/// Removes a file, if it is there.
///
/// # Errors
///
/// Where the system refuses.
pub fn remove_file(path: &Path) -> io::Result<()> {
    before(Operation::Remove, path)?;
    match patiently(cfg!(windows), || fs::remove_file(path)) {
        Err(cause) if cause.kind() != io::ErrorKind::NotFound => Err(cause),
        _ => Ok(()),
    }
}

/// Removes a folder, if it is there and empty.
///
/// # Errors
///
/// Where the system refuses.
pub fn remove_empty_folder(path: &Path) -> io::Result<()> {
    before(Operation::Remove, path)?;
    match patiently(cfg!(windows), || fs::remove_dir(path)) {
        Err(cause)
            if !matches!(
                cause.kind(),
                io::ErrorKind::NotFound | io::ErrorKind::DirectoryNotEmpty
            ) =>
        {
            Err(cause)
        }
        _ => Ok(()),
    }
}

/// Removes a folder with all that is in it, if it is there; links are removed and not followed.
/// Only for folders that this program made under a name of its own.
///
/// # Errors
///
/// Where the system refuses.
pub fn remove_own_folder(path: &Path) -> io::Result<()> {
    match fs::symlink_metadata(path) {
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(cause) => return Err(cause),
        Ok(found) if !found.is_dir() => return remove_file(path),
        Ok(_) => {}
    }
    for entry in fs::read_dir(path)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            remove_own_folder(&entry.path())?;
        } else {
            remove_file(&entry.path())?;
        }
    }
    remove_empty_folder(path)
}

/// Makes a folder and those above it, where they are missing.
///
/// # Errors
///
/// Where the system refuses.
pub fn create_folders(path: &Path) -> io::Result<()> {
    if path.is_dir() {
        return Ok(());
    }
    if let Some(parent) = path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        create_folders(parent)?;
    }
    before(Operation::CreateFolder, path)?;
    match fs::create_dir(path) {
        // Another thread or process was faster.
        Err(cause) if cause.kind() == io::ErrorKind::AlreadyExists && path.is_dir() => Ok(()),
        made => made,
    }
}

/// Waits until the names in a folder are on the disk. Systems that cannot open folders as files
/// keep names in order by themselves.
///
/// # Errors
///
/// Where the system refuses.
pub fn sync_folder(path: &Path) -> io::Result<()> {
    before(Operation::SyncFolder, path)?;
    #[cfg(unix)]
    File::open(if path.as_os_str().is_empty() { Path::new(".") } else { path })?.sync_all()?;
    Ok(())
}

/// The path that symbolic links lead to, whether anything is there or not.
///
/// # Errors
///
/// Where links lead to each other.
pub(crate) fn end_of_links(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..MAX_LINKS {
        match fs::read_link(&path) {
            Ok(next) => path = folder_of(&path).join(next),
            Err(_) => return Ok(path),
        }
    }
    Err(io::Error::other("symbolic links lead to each other"))
}

/// The name under which a file or folder is written: hidden, and in the same folder.
pub(crate) fn part_of(target: &Path) -> PathBuf {
    let name = target.file_name().unwrap_or_default();
    let mut part = OsString::from(".");
    match name.to_str() {
        Some(text) if text.len() > MAX_NAME_BYTES => {
            // FNV-1a of the whole name keeps the parts of two long names apart.
            let hash = text.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| {
                (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3)
            });
            let end = (0..=MAX_NAME_BYTES - 16)
                .rev()
                .find(|end| text.is_char_boundary(*end))
                .unwrap_or(0);
            part.push(format!("{}{hash:016x}", &text[..end]));
        }
        _ => part.push(name),
    }
    part.push(PART);
    target.with_file_name(part)
}

/// What tells whether two paths lead to one file: device and inode, or else the canonical path.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FileId(Identity);

#[cfg(unix)]
type Identity = (u64, u64);
#[cfg(not(unix))]
type Identity = PathBuf;

impl FileId {
    /// Of the file that a path leads to, through all links; `None` where there is none.
    pub fn of(path: &Path) -> Option<Self> {
        #[cfg(unix)]
        {
            use std::os::unix::fs::MetadataExt;
            let found = fs::metadata(path).ok()?;
            Some(Self((found.dev(), found.ino())))
        }
        #[cfg(not(unix))]
        path.canonicalize().ok().map(Self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_holds_a_file_open_is_waited_for() {
        let mut tries = 0;
        let mut change = |is_held_up, kind, passes: usize| {
            tries = 0;
            patiently(is_held_up, || {
                tries += 1;
                if tries > passes { Ok(tries) } else { Err(io::Error::from(kind)) }
            })
        };
        let denied = io::ErrorKind::PermissionDenied;
        assert_eq!(change(true, denied, 3).unwrap(), 4);
        assert_eq!(change(false, denied, 1).unwrap_err().kind(), denied);
        let missing = io::ErrorKind::NotFound;
        assert_eq!(change(true, missing, 1).unwrap_err().kind(), missing);
    }
}
