//! Reading and writing of little-endian numbers. The reader knows the number of bytes that are
//! left, so that it rejects an impossible count before it allocates memory.

use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::{Path, PathBuf};

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;

use crate::{Error, Result, rotation};

/// A binary file with its current offset.
pub(crate) struct Reader<R = BufReader<File>> {
    inner: R,
    path: PathBuf,
    offset: u64,
    length: u64,
}

impl Reader {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path))?;
        let length = file.metadata().map_err(Error::io(path))?.len();
        Ok(Self::new(BufReader::with_capacity(1 << 16, file), path, length))
    }
}

impl<R: Read> Reader<R> {
    /// Reads the first `length` bytes.
    pub(crate) fn new(inner: R, path: &Path, length: u64) -> Self {
        Self { inner, path: path.to_owned(), offset: 0, length }
    }

    pub(crate) fn error(&self, what: impl Into<String>) -> Error {
        Error::Bytes { path: self.path.clone(), offset: self.offset, what: what.into() }
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn remaining(&self) -> u64 {
        self.length.saturating_sub(self.offset)
    }

    pub(crate) fn bytes<const N: usize>(&mut self, what: &str) -> Result<[u8; N]> {
        let mut bytes = [0; N];
        self.fill(&mut bytes, what)?;
        Ok(bytes)
    }

    pub(crate) fn fill(&mut self, bytes: &mut [u8], what: &str) -> Result<()> {
        if self.remaining() < bytes.len() as u64 {
            return Err(self.error(format!("the file ends within {what}")));
        }
        self.inner
            .read_exact(bytes)
            .map_err(|cause| Error::Io { path: self.path.clone(), cause })?;
        self.offset += bytes.len() as u64;
        Ok(())
    }

    /// Reads a count of records of at least `min_bytes` each; an error if the rest of the file
    /// cannot hold them.
    pub(crate) fn count(&mut self, min_bytes: u64, what: &str) -> Result<usize> {
        let count = self.u64(what)?;
        self.check_count(count, min_bytes, what)
    }

    /// An empty list with room for `count` items. A sparse file may announce more than memory
    /// holds, and yet be long enough.
    pub(crate) fn list<T>(&self, count: usize) -> Result<Vec<T>> {
        let mut list = Vec::new();
        match list.try_reserve_exact(count) {
            Ok(()) => Ok(list),
            Err(_) => Err(self.error(format!("{count} records are more than memory holds"))),
        }
    }

    /// The count as `usize`; an error if the rest of the file cannot hold `count` records.
    pub(crate) fn check_count(&self, count: u64, min_bytes: u64, what: &str) -> Result<usize> {
        let left = self.remaining();
        if count.checked_mul(min_bytes).is_none_or(|bytes| bytes > left) {
            return Err(self.error(format!("{what} is {count}, but only {left} bytes follow")));
        }
        usize::try_from(count)
            .map_err(|_| self.error(format!("{what} is {count}, too many for this machine")))
    }

    pub(crate) fn u8(&mut self, what: &str) -> Result<u8> {
        Ok(self.bytes::<1>(what)?[0])
    }

    pub(crate) fn u32(&mut self, what: &str) -> Result<u32> {
        self.bytes(what).map(u32::from_le_bytes)
    }

    pub(crate) fn i32(&mut self, what: &str) -> Result<i32> {
        self.bytes(what).map(i32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self, what: &str) -> Result<u64> {
        self.bytes(what).map(u64::from_le_bytes)
    }

    /// Any number, also NaN and infinity.
    pub(crate) fn raw_f64(&mut self, what: &str) -> Result<f64> {
        self.bytes(what).map(f64::from_le_bytes)
    }

    /// A finite number.
    pub(crate) fn f64(&mut self, what: &str) -> Result<f64> {
        let value = self.raw_f64(what)?;
        if value.is_finite() { Ok(value) } else { Err(self.error(format!("{what} is {value}"))) }
    }

    pub(crate) fn vector3(&mut self, what: &str) -> Result<Vector3<f64>> {
        Ok(Vector3::new(self.f64(what)?, self.f64(what)?, self.f64(what)?))
    }

    /// A transform as qw qx qy qz tx ty tz.
    pub(crate) fn pose(&mut self, what: &str) -> Result<Rigid3> {
        let wxyz = [self.f64(what)?, self.f64(what)?, self.f64(what)?, self.f64(what)?];
        let rotation =
            rotation::from_wxyz(wxyz).map_err(|cause| self.error(format!("{what}: {cause}")))?;
        Ok(Rigid3::new(rotation, self.vector3(what)?))
    }

    /// Bytes up to a zero, as UTF-8.
    pub(crate) fn c_string(&mut self, what: &str) -> Result<String> {
        let mut bytes = Vec::new();
        loop {
            match self.u8(what)? {
                0 => break,
                byte => bytes.push(byte),
            }
        }
        String::from_utf8(bytes).map_err(|_| self.error(format!("{what} is not UTF-8")))
    }

    /// Bytes up to a line feed, as UTF-8.
    pub(crate) fn line(&mut self, max_bytes: u64) -> Result<String> {
        let mut bytes = Vec::new();
        loop {
            match self.u8("a line")? {
                b'\n' => break,
                byte => bytes.push(byte),
            }
            if bytes.len() as u64 > max_bytes {
                return Err(self.error(format!("a line is longer than {max_bytes} bytes")));
            }
        }
        String::from_utf8(bytes).map_err(|_| self.error("a line is not UTF-8"))
    }

    /// An error unless the file ends here.
    pub(crate) fn end(&self) -> Result<()> {
        match self.remaining() {
            0 => Ok(()),
            left => Err(self.error(format!("{left} bytes follow the last record"))),
        }
    }
}

/// A transform as qw qx qy qz tx ty tz.
pub(crate) fn pose_numbers(pose: &Rigid3) -> [f64; 7] {
    let (q, t) = (&pose.rotation, &pose.translation);
    [q.w, q.i, q.j, q.k, t.x, t.y, t.z]
}

/// Writes numbers little-endian.
pub(crate) trait WriteLe: Write {
    fn u8(&mut self, value: u8) -> io::Result<()> {
        self.write_all(&[value])
    }
    fn u32(&mut self, value: u32) -> io::Result<()> {
        self.write_all(&value.to_le_bytes())
    }
    fn i32(&mut self, value: i32) -> io::Result<()> {
        self.write_all(&value.to_le_bytes())
    }
    fn u64(&mut self, value: u64) -> io::Result<()> {
        self.write_all(&value.to_le_bytes())
    }
    fn f64(&mut self, value: f64) -> io::Result<()> {
        self.write_all(&value.to_le_bytes())
    }
    fn f64s(&mut self, values: &[f64]) -> io::Result<()> {
        values.iter().try_for_each(|value| self.f64(*value))
    }
}

impl<W: Write> WriteLe for W {}
