use std::path::{Path, PathBuf};

use tiepoint_scene as scene;

/// What can go wrong with a file. Each message is one sentence that names the file and, where there
/// is one, the place in it.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refuses.
    #[error("{path}: {cause}")]
    Io {
        /// Which file or folder.
        path: PathBuf,
        /// What it says.
        cause: std::io::Error,
    },
    /// A binary file breaks its format.
    #[error("{path}: byte {offset}: {what}")]
    Bytes {
        /// Which file.
        path: PathBuf,
        /// Where, from its beginning.
        offset: u64,
        /// What is wrong there.
        what: String,
    },
    /// A text file breaks its format.
    #[error("{path}: line {line}: {what}")]
    Line {
        /// Which file.
        path: PathBuf,
        /// Where, counted from 1.
        line: usize,
        /// What is wrong there.
        what: String,
    },
    /// The parts of a file, or of several that belong together, contradict each other; or it holds
    /// what is not supported.
    #[error("{path}: {what}")]
    Content {
        /// Which file or folder.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// SQLite refuses.
    #[error("{path}: {cause}")]
    Database {
        /// Which file.
        path: PathBuf,
        /// What it says.
        cause: String,
    },
    /// What was read, or is to be written, is no consistent reconstruction.
    #[error("{path}: {cause}")]
    Model {
        /// Which file or folder.
        path: PathBuf,
        /// What is wrong.
        cause: scene::Error,
    },
}

/// A result with this crate's [`enum@Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        move |cause| Self::Io { path: path.to_owned(), cause }
    }

    pub(crate) fn content(path: &Path, what: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), what: what.into() }
    }
}
