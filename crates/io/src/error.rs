use std::path::{Path, PathBuf};

use tiepoint_scene as scene;

/// The error of this crate. Each message is one sentence that names the file and, where there is
/// one, the place in it.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system reports an error.
    #[error("{path}: {}", tiepoint_store::of_system(cause))]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        cause: std::io::Error,
    },
    /// A file cannot be written, or is not a regular one.
    #[error(transparent)]
    Store(#[from] tiepoint_store::Error),
    /// A binary file violates its format.
    #[error("{path}: byte {offset}: {what}")]
    Bytes {
        /// The file.
        path: PathBuf,
        /// Offset of the violation from the beginning of the file, in bytes.
        offset: u64,
        /// The violation.
        what: String,
    },
    /// A text file violates its format.
    #[error("{path}: line {line}: {what}")]
    Line {
        /// The file.
        path: PathBuf,
        /// Number of the line, counted from 1.
        line: usize,
        /// The violation.
        what: String,
    },
    /// A file contradicts itself or the files that belong to it, or holds content that is not
    /// supported.
    #[error("{path}: {what}")]
    Content {
        /// The file or folder.
        path: PathBuf,
        /// The contradiction, or the content that is not supported.
        what: String,
    },
    /// SQLite reports an error.
    #[error("{path}: {cause}")]
    Database {
        /// The file.
        path: PathBuf,
        /// The message of SQLite.
        cause: String,
    },
    /// The reconstruction that was read, or is to be written, is not consistent
    /// ([`scene::Reconstruction::validate`]).
    #[error("{path}: {cause} (all are numbered from 0, in the order of their ids)")]
    Model {
        /// The file or folder.
        path: PathBuf,
        /// The first inconsistency.
        cause: scene::Error,
    },
}

/// A result with this crate's [`enum@Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// Converts an error of the operating system for a path.
    pub fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        move |cause| Self::Io { path: path.to_owned(), cause }
    }

    /// [`Error::Content`] of a path.
    pub fn content(path: &Path, what: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), what: what.into() }
    }
}
