//! Files whose header has a count that is known only at the end: the records are written to a
//! second file, and copied behind the header.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use tiepoint_store::disk::{self, WrittenFile};

use crate::{Error, Result};

/// Records that are written one after the other, before their number is known.
#[derive(Debug)]
pub(crate) struct CountedFile {
    path: PathBuf,
    records: PathBuf,
    writer: BufWriter<WrittenFile>,
    pub(crate) count: u64,
}

impl CountedFile {
    /// Begins a new file. The records are in a file beside it until it is finished.
    pub(crate) fn create(path: &Path) -> Result<Self> {
        let mut records = path.as_os_str().to_owned();
        records.push(".records");
        let records = PathBuf::from(records);
        disk::remove_file(&records).map_err(Error::io(&records))?;
        let file = WrittenFile::create_new(&records).map_err(Error::io(&records))?;
        let writer = BufWriter::with_capacity(1 << 16, file);
        Ok(Self { path: path.to_owned(), records, writer, count: 0 })
    }

    /// Writes a record.
    pub(crate) fn push(&mut self, bytes: &[u8]) -> Result<()> {
        self.count += 1;
        self.writer.write_all(bytes).map_err(Error::io(&self.path))
    }

    /// Writes the header and the records behind it, and waits until they are on the disk.
    pub(crate) fn finish(self, header: &[u8]) -> Result<()> {
        let Self { path, records, mut writer, .. } = self;
        let copy = || -> io::Result<()> {
            writer.flush()?;
            drop(writer);
            let mut file = BufWriter::new(WrittenFile::create_new(&path)?);
            file.write_all(header)?;
            io::copy(&mut File::open(&records)?, &mut file)?;
            let file = file.into_inner().map_err(io::IntoInnerError::into_error)?;
            file.sync()?;
            disk::remove_file(&records)
        };
        copy().map_err(Error::io(&path))
    }
}
