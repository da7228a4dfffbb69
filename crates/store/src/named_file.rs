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

/// What [`write_file`] may replace, beside an empty file and one of the same content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Replace {
    /// Nothing.
    Nothing,
    /// A file with this program's mark.
    Marked(Mark),
    /// Any file that is not an input, but not through a link: the user said so.
    Anything,
}

impl Replace {
    /// [`Replace::Anything`] if the user said so, and a file with the mark otherwise.
    pub fn new(mark: Option<Mark>, overwrite: bool) -> Self {
        match mark {
            _ if overwrite => Self::Anything,
            Some(mark) => Self::Marked(mark),
            None => Self::Nothing,
        }
    }
}

/// Writes a file that the user named, by calling `write` with a path. An existing file is replaced
/// only if it is empty, has the same content, or `replace` permits it. An input of the command is
/// never replaced.
///
/// # Errors
///
/// The file is an input, or may not be replaced, or only through a link, and those of `write`.
pub fn write_file<'a, E: From<Error>>(
    path: &Path,
    inputs: impl IntoIterator<Item = &'a Path>,
    replace: Replace,
    write: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    if let Some(id) = FileId::of(path)
        && inputs.into_iter().any(|input| FileId::of(input).as_ref() == Some(&id))
    {
        return Err(Error::IsInput { path: path.to_owned() }.into());
    }
    // A link to a device, as /dev/stdout is one, may stay.
    let is_device = || fs::metadata(path).is_ok_and(|found| !found.is_file());
    if replace == Replace::Anything && path.is_symlink() && !is_device() {
        // The user named the link, and maybe somebody else chose where it leads.
        return Err(Error::NamedLink { path: path.to_owned() }.into());
    }
    if may_be_replaced(path, replace)? {
        return write(path);
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let new = path.with_file_name(format!(".{name}{STAGED}"));
    let same = write(&new).and_then(|()| Ok(is_same(&new, path)?));
    disk::remove_file(&new).map_err(Error::output(&new))?;
    if same? { Ok(()) } else { Err(Error::NamedFile { path: path.to_owned() }.into()) }
}

/// Whether [`write_file`] may replace what is at a path, if the content differs: nothing, an empty
/// file, a device, or a file that `replace` permits.
///
/// # Errors
///
/// The file cannot be read.
pub fn may_be_replaced(path: &Path, replace: Replace) -> Result<bool, Error> {
    let unreadable = |cause| Error::Unreadable { path: path.to_owned(), cause };
    match fs::metadata(path) {
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => return Ok(true),
        Err(cause) => return Err(unreadable(cause)),
        // Devices are written to; folders are rejected when writing.
        Ok(found) if !found.is_file() || found.len() == 0 => return Ok(true),
        Ok(_) => {}
    }
    let mark = match replace {
        Replace::Nothing => return Ok(false),
        Replace::Anything => return Ok(true),
        Replace::Marked(mark) => mark,
    };
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
        let marked = Replace::Marked(Mark::Start("# made by us"));
        let put = |text: &str, inputs: &[&Path], replace: Replace| {
            write_file(&path, inputs.iter().copied(), replace, |path| {
                AtomicFile::write_with(path, |file| io::Write::write_all(file, text.as_bytes()))
            })
        };
        fs::write(&path, "").unwrap();
        put("mine", &[], Replace::Nothing).unwrap();
        put("mine", &[], Replace::Nothing).unwrap();
        let is_refused = |found: Result<(), Error>| matches!(found, Err(Error::NamedFile { .. }));
        assert!(is_refused(put("other", &[], Replace::Nothing)));
        assert!(is_refused(put("other", &[], marked)));
        for replace in [Replace::Nothing, Replace::Anything] {
            assert!(matches!(put("mine", &[&path], replace), Err(Error::IsInput { .. })));
        }
        assert_eq!(fs::read(&path).unwrap(), b"mine");
        fs::write(&path, "1 2 3\n# made by us was wrong here\n").unwrap();
        assert!(is_refused(put("other", &[], marked)));
        fs::write(&path, "# made by us\n1 2 3\n").unwrap();
        put("other", &[], marked).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"other");
        put("any", &[], Replace::Anything).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"any");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
        #[cfg(unix)]
        {
            let theirs = dir.path().join("theirs.txt");
            fs::rename(&path, &theirs).unwrap();
            std::os::unix::fs::symlink(&theirs, &path).unwrap();
            let through_link = put("more", &[], Replace::Anything);
            assert!(matches!(through_link, Err(Error::NamedLink { .. })));
            assert_eq!(fs::read(&theirs).unwrap(), b"any");
            fs::remove_file(&theirs).unwrap();
            let through_link = put("more", &[], Replace::Anything);
            assert!(matches!(through_link, Err(Error::NamedLink { .. })));
            assert!(!theirs.exists());
        }
    }
}
