use std::io;
use std::path::{Path, PathBuf};

/// Why a file or folder was not read or written. Each message is one sentence: what failed, on
/// which file, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system reports an error.
    #[error("{path}: {}", of_system(cause))]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        cause: io::Error,
    },
    /// A path is not what it has to be.
    #[error("{path}: {what}")]
    Content {
        /// The file or folder.
        path: PathBuf,
        /// What is there instead.
        what: String,
    },
    /// A file or folder cannot be written.
    #[error("cannot write {path}: {}; choose a folder that can be written", of_system(cause))]
    Output {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        cause: io::Error,
    },
    /// An existing file or folder cannot be read.
    #[error("cannot read {path}: {}", of_system(cause))]
    Unreadable {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        cause: io::Error,
    },
    /// Another process has locked the folder.
    #[error("{path} is in use by another run: wait for it to end, or choose another folder")]
    InUse {
        /// The folder.
        path: PathBuf,
    },
    /// A result would replace a file that this program did not write, or that was changed since.
    #[error(
        "{path} exists, and this program did not make it or it was changed since: move it away, \
        or choose another place for the result"
    )]
    ForeignFile {
        /// The file.
        path: PathBuf,
    },
    /// A result that the user named would replace a file that this program did not write, or that
    /// was changed since.
    #[error(
        "{path} exists, and this program did not make it or it was changed since: move it away, \
        choose another place for the result, or replace it with `output.overwrite`"
    )]
    NamedFile {
        /// The file.
        path: PathBuf,
    },
    /// An interrupted run has committed results that are not all in their final places yet.
    #[error(
        "an earlier run was interrupted while it moved its results into {path}: give the \
        command of that run again to complete it"
    )]
    Unfinished {
        /// The folder.
        path: PathBuf,
    },
    /// The results of a run are committed, and moving them into their places failed.
    #[error(
        "the results are complete, but not all of them could be moved into {path}: {}; give \
        the same command again when the cause is gone",
        of_system(cause)
    )]
    NotInPlace {
        /// The folder.
        path: PathBuf,
        /// The error of the operating system.
        cause: io::Error,
    },
    /// A part of a name in an output folder is a symbolic link.
    #[error(
        "{path} is a symbolic link inside a folder that results are written to, and this program \
        does not write through it: remove the link, or choose another folder with -o"
    )]
    LinkInFolder {
        /// The link.
        path: PathBuf,
    },
    /// A file that the user permits to replace is a symbolic link.
    #[error(
        "{path} is a symbolic link, and `output.overwrite` does not write through it: name the \
        file that it leads to, or remove the link"
    )]
    NamedLink {
        /// The link.
        path: PathBuf,
    },
    /// The result would overwrite an input.
    #[error(
        "{path} is read by this command, so the result cannot be written there: choose another \
        place"
    )]
    IsInput {
        /// The file.
        path: PathBuf,
    },
    /// A name leads out of the folder.
    #[error("the name {name:?} leads out of {path}: choose another name")]
    NotInside {
        /// The folder.
        path: PathBuf,
        /// The name.
        name: String,
    },
}

/// The words of an error of the operating system, without its number.
pub fn of_system(cause: &io::Error) -> String {
    let mut text = cause.to_string();
    if let (Some(_), Some(end)) = (cause.raw_os_error(), text.rfind(" (os error ")) {
        text.truncate(end);
    }
    text
}

/// A result with this crate's [`enum@Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    pub(crate) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |cause| Self::Io { path: path.to_owned(), cause }
    }

    pub(crate) fn content(path: &Path, what: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), what: what.into() }
    }

    /// Converts an error of the operating system to [`Error::Output`] for a path.
    pub fn output(path: &Path) -> impl FnOnce(io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |cause| Self::Output { path, cause }
    }

    /// Converts an error of the operating system to [`Error::Unreadable`] for a path.
    pub fn unreadable(path: &Path) -> impl FnOnce(io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |cause| Self::Unreadable { path, cause }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_the_system_has_words_and_no_number() {
        let path = Path::new("no/such/file");
        let error = Error::unreadable(path)(std::fs::read(path).unwrap_err()).to_string();
        assert!(error.starts_with("cannot read no/such/file: ") && error.len() > 26, "{error}");
        assert!(!error.contains("os error"), "{error}");
        // What we say ourselves stays.
        let own = io::Error::other("a (os error 2) of ours");
        assert_eq!(of_system(&own), "a (os error 2) of ours");
    }
}
