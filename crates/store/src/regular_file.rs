//! Regular files, and paths in messages.

use std::fs::{self, Metadata};
use std::path::Path;

use crate::{Error, Result};

/// Refuses a path that leads to something other than a regular file. Opening a named pipe would
/// block until another process writes to it. Links are followed. A path that leads nowhere is
/// accepted: the call that opens it reports the error.
///
/// # Errors
///
/// [`Error::Content`] with the kind of the file system entry: a folder, a named pipe, a socket, a
/// device.
pub fn require_regular_file(path: &Path) -> Result<()> {
    match fs::metadata(path).ok().as_ref().and_then(irregular_kind) {
        Some(kind) => {
            Err(Error::content(path, format!("is {kind} and no regular file: give a file")))
        }
        None => Ok(()),
    }
}

/// The kind of an entry that is not a regular file; `None` for a regular file.
pub fn irregular_kind(metadata: &Metadata) -> Option<&'static str> {
    if metadata.is_file() {
        return None;
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        let kind = metadata.file_type();
        if kind.is_fifo() {
            return Some("a named pipe");
        }
        if kind.is_socket() {
            return Some("a socket");
        }
    }
    Some(if metadata.is_dir() { "a folder" } else { "a device" })
}

/// A path for a message: control characters and bytes that are not UTF-8 are escaped.
pub fn escaped(path: &Path) -> String {
    let mut text = String::new();
    for chunk in path.as_os_str().as_encoded_bytes().utf8_chunks() {
        for c in chunk.valid().chars() {
            if c.is_control() { text.extend(c.escape_debug()) } else { text.push(c) }
        }
        text.extend(chunk.invalid().iter().map(|byte| format!("\\x{byte:02x}")));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_refused_and_missing_files_are_accepted() {
        let dir = tempfile::tempdir().unwrap();
        let error = require_regular_file(dir.path()).unwrap_err().to_string();
        assert!(error.contains("is a folder and no regular file"), "{error}");
        require_regular_file(&dir.path().join("none")).unwrap();
        let file = dir.path().join("file");
        fs::write(&file, "").unwrap();
        require_regular_file(&file).unwrap();
    }

    #[test]
    #[cfg(unix)]
    fn escaped_paths_have_one_line() {
        use std::os::unix::ffi::OsStrExt;
        let path = Path::new(std::ffi::OsStr::from_bytes(b"a\nb\xff\xc3/\xc3\xa4 c\x1b.jpg"));
        assert_eq!(escaped(path), r"a\nb\xff\xc3/ä c\u{1b}.jpg");
    }
}
