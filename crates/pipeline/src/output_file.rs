//! Safe writing of single output files.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use tiepoint_io::AtomicFile;
use tiepoint_io::disk::{self, FileId};

use crate::Error;
use crate::output_folder::{STAGED, output};

/// Marks a PLY file as written by this program.
pub(crate) const PLY_MARK: &str = "\ncomment tiepoint\n";
/// Marks a LAS or LAZ file as written by this program: the generating software in its header, which
/// zeros surround.
pub(crate) const LAS_MARK: &str = "\0tiepoint\0";
/// Marks a binary glTF file as written by this program: the first member of its JSON part.
pub(crate) const GLTF_MARK: &str = r#"{"asset":{"generator":"tiepoint""#;
/// Start of the first line of a text file of this program, if its format has comments.
pub(crate) const COMMENT_MARK: &str = "# tiepoint";
/// Marks an HTML page as written by this program.
const PAGE_MARK: &str = "<title>tiepoint</title>";
/// Marks are searched for in the first bytes of a file.
const HEAD_BYTES: u64 = 4096;

/// Writes a file that the user named, by calling `write` with a path. An existing file is replaced
/// only if it is empty, has this program's `mark`, or has the same content. An input of the command
/// is never replaced.
///
/// # Errors
///
/// The file is an input or not this program's, and those of `write`.
pub(crate) fn write_file<'a>(
    path: &Path,
    inputs: impl IntoIterator<Item = &'a Path>,
    mark: Option<&str>,
    write: impl FnOnce(&Path) -> Result<(), Error>,
) -> Result<(), Error> {
    if let Some(id) = FileId::of(path)
        && inputs.into_iter().any(|input| FileId::of(input).as_ref() == Some(&id))
    {
        return Err(Error::IsInput { path: path.to_owned() });
    }
    if may_be_replaced(path, mark)? {
        return write(path);
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let new = path.with_file_name(format!(".{name}{STAGED}"));
    let same = write(&new).and_then(|()| is_same(&new, path));
    disk::remove_file(&new).map_err(output(&new))?;
    if same? { Ok(()) } else { Err(Error::ForeignFile { path: path.to_owned() }) }
}

/// Writes an HTML page. An existing page is replaced only if this program wrote it.
///
/// # Errors
///
/// A foreign page or a link exists, or the page cannot be written.
pub fn write_page(path: &Path, html: &str) -> Result<(), Error> {
    refuse_link(path)?;
    write_file(path, [], Some(PAGE_MARK), |path| {
        Ok(AtomicFile::write_with(path, |file| io::Write::write_all(file, html.as_bytes()))?)
    })
}

/// Checks before any work is done that [`write_page`] may write.
///
/// # Errors
///
/// A foreign page exists, or a link: the program chose the name, and the folder may be somebody
/// else's.
pub fn refuse_foreign_page(path: &Path) -> Result<(), Error> {
    refuse_link(path)?;
    if may_be_replaced(path, Some(PAGE_MARK))? {
        Ok(())
    } else {
        Err(Error::ForeignFile { path: path.to_owned() })
    }
}

fn refuse_link(path: &Path) -> Result<(), Error> {
    match fs::symlink_metadata(path) {
        Ok(found) if found.is_symlink() => Err(Error::LinkInFolder { path: path.to_owned() }),
        _ => Ok(()),
    }
}

fn may_be_replaced(path: &Path, mark: Option<&str>) -> Result<bool, Error> {
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
    if mark == COMMENT_MARK {
        return Ok(head.starts_with(mark.as_bytes()));
    }
    Ok(head.windows(mark.len()).any(|bytes| bytes == mark.as_bytes()))
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

    #[test]
    fn foreign_files_and_inputs_are_not_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.txt");
        let put = |text: &str, inputs: &[&Path], mark: Option<&str>| {
            write_file(&path, inputs.iter().copied(), mark, |path| {
                Ok(AtomicFile::write_with(path, |file| {
                    io::Write::write_all(file, text.as_bytes())
                })?)
            })
        };
        fs::write(&path, "").unwrap();
        put("mine", &[], None).unwrap();
        put("mine", &[], None).unwrap();
        assert!(matches!(put("other", &[], None), Err(Error::ForeignFile { .. })));
        assert!(matches!(put("other", &[], Some(COMMENT_MARK)), Err(Error::ForeignFile { .. })));
        assert!(matches!(put("mine", &[&path], None), Err(Error::IsInput { .. })));
        assert_eq!(fs::read(&path).unwrap(), b"mine");
        fs::write(&path, format!("1 2 3\n{COMMENT_MARK} was wrong here\n")).unwrap();
        assert!(matches!(put("other", &[], Some(COMMENT_MARK)), Err(Error::ForeignFile { .. })));
        fs::write(&path, format!("{COMMENT_MARK}\n1 2 3\n")).unwrap();
        put("other", &[], Some(COMMENT_MARK)).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"other");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
