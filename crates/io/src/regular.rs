//! What can be read as a file from end to end, and how its name is told.

use std::fs::{self, Metadata};
use std::path::Path;

use crate::{Error, Result};

/// Refuses what is there and is no regular file: opening a named pipe would wait for somebody to
/// write to it, perhaps for ever. Links are followed. Where nothing is there, whoever opens it says
/// so.
///
/// # Errors
///
/// One sentence that says what it is instead of a file.
pub fn require_regular_file(path: &Path) -> Result<()> {
    match fs::metadata(path).ok().as_ref().and_then(irregular) {
        Some(kind) => {
            Err(Error::content(path, format!("is {kind} and no regular file: give a file")))
        }
        None => Ok(()),
    }
}

/// What it is that is no regular file.
pub(crate) fn irregular(metadata: &Metadata) -> Option<&'static str> {
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

/// A path as it can be shown: escapes take the place of control characters and of bytes that are no
/// UTF-8.
pub(crate) fn escaped(path: &Path) -> String {
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
    fn a_folder_is_no_file_and_nothing_is_left_to_whoever_opens_it() {
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
    fn names_are_shown_on_one_line() {
        use std::os::unix::ffi::OsStrExt;
        let path = Path::new(std::ffi::OsStr::from_bytes(b"a\nb\xff\xc3/\xc3\xa4 c\x1b.jpg"));
        assert_eq!(escaped(path), r"a\nb\xff\xc3/ä c\u{1b}.jpg");
    }
}
