//! The format of the files that only this program reads again: `stages.json`, its rows in the
//! database, and the `tiepoint.json` of a model. Each begins with the number of its format, so that
//! a file of another version is refused instead of being misread. `rig.json` is written so, too,
//! and not read.

use std::path::Path;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize, Serializer};

use crate::Error;

/// The format that is written, and the only one that is read.
const FORMAT: u64 = 1;

/// A file's content with its format.
#[derive(Serialize)]
struct Numbered<'a, T> {
    format: u64,
    #[serde(flatten)]
    content: &'a T,
}

/// What is read of a file before its content.
#[derive(Deserialize)]
#[serde(expecting = "an object")]
struct Header {
    /// `None` in files of before 0.1.0.
    format: Option<u64>,
}

/// Pretty JSON with a final line break.
pub(crate) fn json(value: &impl Serialize) -> Vec<u8> {
    let mut text = serde_json::to_vec_pretty(value)
        .expect("our own types are JSON: string keys, finite numbers");
    text.push(b'\n');
    text
}

/// A path for JSON, which has no bytes that are not UTF-8: each is shown as U+FFFD.
pub(crate) fn path_text<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&path.display())
}

/// Numbers for JSON, which has no infinite ones: they are `None`.
pub(crate) fn finite(values: &[f64]) -> Vec<Option<f64>> {
    values.iter().map(|value| value.is_finite().then_some(*value)).collect()
}

/// A file as JSON, with its format.
pub(crate) fn to_json(content: &impl Serialize) -> Vec<u8> {
    json(&Numbered { format: FORMAT, content })
}

/// The content of the file at `path`. `broken` makes the error of a text that is not JSON of this
/// form.
///
/// # Errors
///
/// [`Error::OtherFormat`] if another version wrote the file, and that of `broken`.
pub(crate) fn from_json<T: DeserializeOwned>(
    path: &Path,
    text: &[u8],
    broken: impl Fn(String) -> Error,
) -> Result<T, Error> {
    let parsed = |error: serde_json::Error| broken(error.to_string());
    match serde_json::from_slice::<Header>(text).map_err(parsed)?.format {
        Some(FORMAT) => serde_json::from_slice(text).map_err(parsed),
        found => Err(Error::OtherFormat { path: path.to_owned(), found, known: FORMAT }),
    }
}
