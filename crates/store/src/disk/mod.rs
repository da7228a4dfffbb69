//! The functions through which this workspace makes every change of the file system.
//!
//! With the feature `faults`, each change is counted and can be made to fail (module `faults`). The
//! feature is for tests.

#[cfg(feature = "faults")]
pub mod faults;

mod change;
mod folder;
mod operation;
mod paths;

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use change::retry_while_denied;
pub use change::{check_fault, is_watched};
pub use folder::Folder;
pub use operation::Operation;
pub use paths::folder_of;

/// Suffix of the name of a file or folder that is being written.
const TEMPORARY_SUFFIX: &str = ".tiepoint-part";
/// Longest file name that a temporary name repeats, in bytes; file systems allow 255.
const MAX_NAME_BYTES: usize = 200;
/// Longest chain of symbolic links, as in Linux.
const MAX_LINKS: usize = 40;

/// A file that is being written.
#[derive(Debug)]
pub struct WrittenFile {
    file: File,
    path: PathBuf,
}

impl WrittenFile {
    /// Creates a file; fails if the path exists.
    ///
    /// # Errors
    ///
    /// If the path exists, and if the system reports an error.
    pub fn create_new(path: &Path) -> io::Result<Self> {
        check_fault(Operation::Create, path)?;
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        Ok(Self { file, path: path.to_owned() })
    }

    /// Opens an existing device or pipe, or the end of an open file, for writing.
    pub(crate) fn open_special(path: &Path) -> io::Result<Self> {
        let file = OpenOptions::new().append(true).open(path)?;
        Ok(Self { file, path: path.to_owned() })
    }

    /// The open file.
    pub fn file(&self) -> &File {
        &self.file
    }

    /// Waits until the content is on the disk (fsync).
    ///
    /// # Errors
    ///
    /// If the system reports an error.
    pub fn sync(&self) -> io::Result<()> {
        check_fault(Operation::Sync, &self.path)?;
        self.file.sync_all()
    }
}

impl Write for WrittenFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        #[cfg(feature = "faults")]
        if let Err(error) = check_fault(Operation::Write, &self.path) {
            // An interrupted write leaves a part of its bytes.
            let _ = self.file.write(&bytes[..faults::partial_write_len(&self.path, bytes.len())]);
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
/// If the path exists, and if the system reports an error.
pub fn write_new(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = WrittenFile::create_new(path)?;
    file.write_all(bytes)?;
    file.sync()
}

/// Copies a file to a new one, and waits until it is on the disk.
///
/// # Errors
///
/// If `to` exists, and if the system reports an error.
pub fn copy_new(from: &Path, to: &Path) -> io::Result<()> {
    let mut source = File::open(from)?;
    let mut file = WrittenFile::create_new(to)?;
    io::copy(&mut source, &mut file)?;
    file.sync()
}

/// Renames a file or folder; replaces a file at `to`. Call [`sync_folder`] afterwards to make the
/// rename durable.
///
/// # Errors
///
/// If the system reports an error.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    check_fault(Operation::Rename, to)?;
    retry_while_denied(cfg!(windows), || fs::rename(from, to))
}

/// Removes a file if it exists.
///
/// # Errors
///
/// If the system reports an error.
pub fn remove_file(path: &Path) -> io::Result<()> {
    check_fault(Operation::Remove, path)?;
    match retry_while_denied(cfg!(windows), || fs::remove_file(path)) {
        Err(cause) if cause.kind() != io::ErrorKind::NotFound => Err(cause),
        _ => Ok(()),
    }
}

/// Removes a folder if it exists and is empty.
///
/// # Errors
///
/// If the system reports an error.
pub fn remove_empty_folder(path: &Path) -> io::Result<()> {
    check_fault(Operation::Remove, path)?;
    match retry_while_denied(cfg!(windows), || fs::remove_dir(path)) {
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

/// Removes a folder with its content if it exists; symbolic links are removed and not followed.
/// Only for folders that this program created under a name of its own.
///
/// # Errors
///
/// If the system reports an error.
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

/// Creates a folder and its missing parents.
///
/// # Errors
///
/// If the system reports an error.
pub fn create_folders(path: &Path) -> io::Result<()> {
    if path.is_dir() {
        return Ok(());
    }
    if let Some(parent) = path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        create_folders(parent)?;
    }
    check_fault(Operation::CreateFolder, path)?;
    match fs::create_dir(path) {
        Err(cause) if cause.kind() == io::ErrorKind::AlreadyExists => match path.is_dir() {
            // Another thread or process created it meanwhile.
            true => Ok(()),
            false => {
                Err(io::Error::other("a file or a link to nothing has the name of the folder"))
            }
        },
        made => made,
    }
}

/// Waits until the entries of a folder are on the disk (fsync). Systems that cannot open folders as
/// files order these writes themselves.
///
/// # Errors
///
/// If the system reports an error.
pub fn sync_folder(path: &Path) -> io::Result<()> {
    check_fault(Operation::SyncFolder, path)?;
    #[cfg(unix)]
    File::open(if path.as_os_str().is_empty() { Path::new(".") } else { path })?.sync_all()?;
    Ok(())
}

/// The path at the end of a chain of symbolic links; the path itself if it is no link.
///
/// # Errors
///
/// If the links form a cycle, or lead to nothing: who made them chose where a file would appear.
pub fn end_of_links(path: &Path) -> io::Result<PathBuf> {
    let mut end = path.to_owned();
    for _ in 0..MAX_LINKS {
        match fs::read_link(&end) {
            Ok(next) => end = folder_of(&end).join(next),
            Err(_) if end != path && !fs::exists(path).unwrap_or(true) => {
                return Err(io::Error::other(
                    "is a symbolic link to nothing: remove the link, or name the file itself",
                ));
            }
            Err(_) => return Ok(end),
        }
    }
    Err(io::Error::other("symbolic links lead to each other"))
}

/// The temporary path of a file or folder while it is written: hidden, in the same folder.
pub fn temporary_path(target: &Path) -> PathBuf {
    let name = target.file_name().unwrap_or_default();
    let mut temporary = OsString::from(".");
    match name.to_str() {
        Some(text) if text.len() > MAX_NAME_BYTES => {
            // The FNV-1a hash of the whole name separates two long names with a common beginning.
            let hash = text.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| {
                (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3)
            });
            let end = (0..=MAX_NAME_BYTES - 16)
                .rev()
                .find(|end| text.is_char_boundary(*end))
                .unwrap_or(0);
            temporary.push(format!("{}{hash:016x}", &text[..end]));
        }
        _ => temporary.push(name),
    }
    temporary.push(TEMPORARY_SUFFIX);
    target.with_file_name(temporary)
}

/// Identity of a file, to compare paths: device and inode, or else the canonical path.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FileId(Identity);

#[cfg(unix)]
type Identity = (u64, u64);
#[cfg(not(unix))]
type Identity = PathBuf;

impl FileId {
    /// The identity of the file at the end of all links; `None` if there is none.
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
