//! Whole files with this crate's error.

use std::io;
use std::path::PathBuf;

use tiepoint_store::AtomicFile;

use crate::Result;

/// [`AtomicFile::write_with`] with this crate's error.
pub(crate) fn write_atomic(
    path: impl Into<PathBuf>,
    content: impl FnOnce(&mut AtomicFile) -> io::Result<()>,
) -> Result<()> {
    Ok(AtomicFile::write_with(path, content)?)
}
