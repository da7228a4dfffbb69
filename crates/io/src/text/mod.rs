//! Text files: lines, the words of a line, and numbers.

pub(crate) mod excerpt;

use std::fmt;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_store::require_regular_file;

use crate::text::excerpt::Excerpt;
use crate::{Error, Result, rotation};

/// Longest line that is read, in bytes. A line of COLMAP holds all keypoints of an image: 2²⁰ of
/// them at 64 characters.
const MAX_LINE_BYTES: u64 = 1 << 26;

/// A file of text, after the byte order mark that editors and spreadsheets write before UTF-8. All
/// readers of text open their files here.
///
/// # Errors
///
/// If the file is no regular one, cannot be read, or is UTF-16.
fn open(path: &Path) -> Result<BufReader<File>> {
    const MARK: &[u8] = b"\xEF\xBB\xBF";
    require_regular_file(path)?;
    let file = File::open(path).map_err(Error::io(path))?;
    let mut reader = BufReader::new(file);
    let begin = reader.fill_buf().map_err(Error::io(path))?;
    let is_utf_16 = match begin {
        [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..] => true,
        // ASCII with a zero beside each character.
        [a, b, c, d, ..] => matches!(
            [a == &0, b == &0, c == &0, d == &0],
            [false, true, false, true] | [true, false, true, false]
        ),
        _ => false,
    };
    if is_utf_16 {
        return Err(Error::content(path, "is UTF-16 text, which is not read: save it as UTF-8"));
    }
    if begin.starts_with(MARK) {
        reader.consume(MARK.len());
    }
    Ok(reader)
}

/// Reads a text file of at most `max_bytes`, without a byte order mark. `what` says in the error
/// what a longer file is not.
///
/// # Errors
///
/// If the file is no regular one, cannot be read, is longer, or is no UTF-8.
pub fn read_text(path: &Path, max_bytes: u64, what: &str) -> Result<String> {
    let mut bytes = Vec::new();
    open(path)?.take(max_bytes + 1).read_to_end(&mut bytes).map_err(Error::io(path))?;
    if bytes.len() as u64 > max_bytes {
        let most = max_bytes >> 20;
        return Err(Error::content(path, format!("has more than {most} MB: it is no {what}")));
    }
    String::from_utf8(bytes).map_err(|_| Error::content(path, "is not UTF-8 text"))
}

/// A file, line by line.
pub(crate) struct Lines {
    inner: BufReader<File>,
    path: PathBuf,
    line: usize,
    buffer: String,
}

impl Lines {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        Ok(Self { inner: open(path)?, path: path.to_owned(), line: 0, buffer: String::new() })
    }

    pub(crate) fn error(&self, what: impl Into<String>) -> Error {
        Error::Line { path: self.path.clone(), line: self.line, what: what.into() }
    }

    /// The next line, trimmed, also if it is empty or a comment.
    pub(crate) fn next_raw(&mut self) -> Result<Option<Words<'_>>> {
        self.line += 1;
        self.buffer.clear();
        let read = (&mut self.inner).take(MAX_LINE_BYTES).read_line(&mut self.buffer);
        let bytes = read.map_err(|cause| match cause.kind() {
            std::io::ErrorKind::InvalidData => self.error("is not UTF-8 text"),
            _ => Error::Io { path: self.path.clone(), cause },
        })?;
        if bytes as u64 == MAX_LINE_BYTES {
            return Err(self.error(format!("is longer than {MAX_LINE_BYTES} bytes")));
        }
        Ok((bytes > 0).then(|| self.current()))
    }

    /// The next line that is neither empty nor a comment.
    pub(crate) fn next(&mut self) -> Result<Option<Words<'_>>> {
        loop {
            match self.next_raw()? {
                None => return Ok(None),
                Some(words) if words.rest.is_empty() || words.rest.starts_with('#') => {}
                // The borrow checker does not permit to return the words of this borrow.
                Some(_) => break,
            }
        }
        Ok(Some(self.current()))
    }
}

impl Lines {
    /// The next line that is neither empty nor a comment; an error that names `what` at the end of
    /// the file.
    pub(crate) fn expect(&mut self, what: &str) -> Result<Words<'_>> {
        // The borrow of a line would extend into the branch of the error.
        if self.next()?.is_none() {
            return Err(self.error(format!("the file ends where {what} should be")));
        }
        Ok(self.current())
    }

    fn current(&self) -> Words<'_> {
        Words { rest: self.buffer.trim(), path: &self.path, line: self.line }
    }
}

/// The rest of a line.
pub(crate) struct Words<'a> {
    rest: &'a str,
    path: &'a Path,
    line: usize,
}

impl<'a> Words<'a> {
    pub(crate) fn error(&self, what: impl Into<String>) -> Error {
        Error::Line { path: self.path.to_owned(), line: self.line, what: what.into() }
    }

    /// Another text in place of the line; errors name the same line.
    pub(crate) fn with_text<'b>(&self, text: &'b str) -> Words<'b>
    where
        'a: 'b,
    {
        Words { rest: text.trim(), path: self.path, line: self.line }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.rest.is_empty()
    }

    /// Takes the whole rest.
    pub(crate) fn rest(&mut self) -> &'a str {
        std::mem::take(&mut self.rest)
    }

    /// Takes the next word; an error that names `what` at the end of the line.
    pub(crate) fn word(&mut self, what: &str) -> Result<&'a str> {
        let rest = self.rest;
        if rest.is_empty() {
            return Err(self.error(format!("ends where {what} should be")));
        }
        let (word, rest) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
        self.rest = rest.trim_start();
        Ok(word)
    }

    /// A number of any integer type.
    pub(crate) fn number<T: FromStr>(&mut self, what: &str) -> Result<T> {
        let word = self.word(what)?;
        word.parse().map_err(|_| {
            self.error(format!("{what} is `{}`, not a number in range", Excerpt(word)))
        })
    }

    /// A finite number.
    pub(crate) fn f64(&mut self, what: &str) -> Result<f64> {
        let value: f64 = self.number(what)?;
        if value.is_finite() { Ok(value) } else { Err(self.error(format!("{what} is {value}"))) }
    }

    pub(crate) fn f64s<const N: usize>(&mut self, what: &str) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64(what)?;
        }
        Ok(values)
    }

    /// A transform as qw qx qy qz tx ty tz.
    pub(crate) fn pose(&mut self, what: &str) -> Result<Rigid3> {
        let rotation = rotation::from_wxyz(self.f64s(what)?)
            .map_err(|cause| self.error(format!("{what}: {cause}")))?;
        Ok(Rigid3::new(rotation, Vector3::from(self.f64s::<3>(what)?)))
    }

    /// An error unless the line ends here.
    pub(crate) fn end(&self) -> Result<()> {
        if self.rest.is_empty() {
            Ok(())
        } else {
            Err(self.error(format!("`{}` follows", Excerpt(self.rest))))
        }
    }
}

/// Displays a number with as many digits as identify it, with an exponent if that is shorter than
/// zeros.
pub(crate) struct Number(pub(crate) f64);

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let magnitude = self.0.abs();
        if magnitude != 0.0 && !(1e-5..1e16).contains(&magnitude) {
            write!(f, "{:e}", self.0)
        } else {
            write!(f, "{}", self.0)
        }
    }
}

/// Displays numbers separated by spaces.
pub(crate) struct Numbers<'a>(pub(crate) &'a [f64]);

impl fmt::Display for Numbers<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, value) in self.0.iter().enumerate() {
            write!(f, "{}{}", if index == 0 { "" } else { " " }, Number(*value))?;
        }
        Ok(())
    }
}
