//! Safe writing of single output files that a user named.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::Error;
use crate::disk::{self, FileId};
use crate::output_folder::STAGED;

/// Marks are searched for in the first bytes of a file.
const HEAD_BYTES: u64 = 4096;

/// Bytes by which a program knows a file as its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// The file starts with this text.
    Start(&'static str),
    /// The first 4096 bytes of the file contain this text.
    Inside(&'static str),
}

/// Writes a file that the user named, by calling `write` with a path. An existing file is replaced
/// only if it is empty, has this program's `mark`, or has the same content. An input of the command
/// is never replaced.
///
/// # Errors
///
/// The file is an input or not this program's, and those of `write`.
pub fn write_file<'a, E: From<Error>>(
    path: &Path,
    inputs: impl IntoIterator<Item = &'a Path>,
    mark: Option<Mark>,
    write: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    if let Some(id) = FileId::of(path)
        && inputs.into_iter().any(|input| FileId::of(input).as_ref() == Some(&id))
    {
        return Err(Error::IsInput { path: path.to_owned() }.into());
    }
    if may_be_replaced(path, mark)? {
        return write(path);
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let new = path.with_file_name(format!(".{name}{STAGED}"));
    let same = write(&new).and_then(|()| Ok(is_same(&new, path)?));
    disk::remove_file(&new).map_err(Error::output(&new))?;
    if same? { Ok(()) } else { Err(Error::ForeignFile { path: path.to_owned() }.into()) }
}

/// Whether [`write_file`] may replace what is at a path, if the content differs: nothing, an empty
/// file, a device, or a file with this program's mark.
///
/// # Errors
///
/// The file cannot be read.
pub fn may_be_replaced(path: &Path, mark: Option<Mark>) -> Result<bool, Error> {
    let unreadable = |cause| Error::Unreadable { path: path.to_owned(), cause };
    match fs::metadata(path) {
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => return Ok(true),
        Err(cause) => return Err(unreadable(cause)),
        // Devices are written to; folders are rejected when writing.
        Ok(found) if !found.is_file() || found.len() == 0 => return Ok(true),
        Ok(_) => {}
    }
    let Some(mark) = mark else { return Ok(false) };
    let mut head = Vec::new();
    File::open(path)
        .and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut head))
        .map_err(unreadable)?;
    Ok(match mark {
        Mark::Start(mark) => head.starts_with(mark.as_bytes()),
        Mark::Inside(mark) => head.windows(mark.len()).any(|bytes| bytes == mark.as_bytes()),
    })
}

fn is_same(one: &Path, other: &Path) -> Result<bool, Error> {
    let read = |path: &Path| -> Result<Vec<u8>, Error> {
        fs::read(path).map_err(|cause| Error::Unreadable { path: PathBuf::from(path), cause })
    };
    Ok(read(one)? == read(other)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AtomicFile;

    #[test]
    fn foreign_files_and_inputs_are_not_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.txt");
        let mark = Mark::Start("# made by us");
        let put = |text: &str, inputs: &[&Path], mark: Option<Mark>| {
            write_file(&path, inputs.iter().copied(), mark, |path| {
                AtomicFile::write_with(path, |file| io::Write::write_all(file, text.as_bytes()))
            })
        };
        fs::write(&path, "").unwrap();
        put("mine", &[], None).unwrap();
        put("mine", &[], None).unwrap();
        assert!(matches!(put("other", &[], None), Err(Error::ForeignFile { .. })));
        assert!(matches!(put("other", &[], Some(mark)), Err(Error::ForeignFile { .. })));
        assert!(matches!(put("mine", &[&path], None), Err(Error::IsInput { .. })));
        assert_eq!(fs::read(&path).unwrap(), b"mine");
        fs::write(&path, "1 2 3\n# made by us was wrong here\n").unwrap();
        assert!(matches!(put("other", &[], Some(mark)), Err(Error::ForeignFile { .. })));
        fs::write(&path, "# made by us\n1 2 3\n").unwrap();
        put("other", &[], Some(mark)).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"other");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
