//! Files that are there complete or not at all: written under another name in the same folder, flushed to the disk, renamed.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::{Error, Result};

/// A file that takes its name with [`AtomicFile::commit`]; dropped before, it leaves nothing behind.
#[derive(Debug)]
pub struct AtomicFile {
    path: PathBuf,
    temporary: PathBuf,
    /// `None` once committed.
    writer: Option<BufWriter<File>>,
}

impl AtomicFile {
    /// Starts to write `path`; its folder must exist.
    pub fn create(path: impl Into<PathBuf>) -> Result<Self> {
        let path = path.into();
        let mut name = std::ffi::OsString::from(".");
        name.push(path.file_name().ok_or_else(|| Error::content(&path, "is not the name of a file"))?);
        name.push(format!(".{}.tmp", std::process::id()));
        let temporary = path.with_file_name(name);
        let file = File::create(&temporary).map_err(Error::io(&path))?;
        Ok(Self { path, temporary, writer: Some(BufWriter::new(file)) })
    }

    /// Writes a whole file: `content` gets a buffered writer.
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

    /// Flushes to the disk and gives the file its name, replacing what had it before.
    pub fn commit(mut self) -> Result<()> {
        let finish = |writer: Option<BufWriter<File>>| {
            if let Some(writer) = writer {
                writer.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
                fs::rename(&self.temporary, &self.path)?;
            }
            Ok(())
        };
        finish(self.writer.take()).map_err(|cause| {
            // The first error is the one to report.
            let _ = fs::remove_file(&self.temporary);
            Error::Io { path: self.path.clone(), cause }
        })
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
        if self.writer.take().is_some() {
            // Nobody is left to tell.
            let _ = fs::remove_file(&self.temporary);
        }
    }
}
