use std::path::PathBuf;

/// The error of this crate.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An option is out of its range.
    #[error("{name} = {value} is out of range: {expected}")]
    OutOfRange {
        /// The option.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The permitted range.
        expected: &'static str,
    },
    /// The arcs of two consecutive corners of a route overlap.
    #[error(
        "corners {corner} and the next are {distance_m:.1} m apart, but their turns take \
        {needed_m:.1} m"
    )]
    CornersTooClose {
        /// Index of the first corner.
        corner: usize,
        /// Distance of the corners, in metres.
        distance_m: f64,
        /// Length that the arcs take, in metres.
        needed_m: f64,
    },
    /// There is no preset or direction of that name.
    #[error("unknown {what} `{name}`: known are {known}")]
    UnknownName {
        /// The kind of name.
        what: &'static str,
        /// The name given.
        name: String,
        /// The known names.
        known: String,
    },
    /// A file could not be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// An image could not be encoded.
    #[error("cannot encode {path}: {reason}")]
    Encode {
        /// The file.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
}

/// An [`Error::OutOfRange`] unless `ok`.
pub(crate) fn require(
    ok: bool,
    name: &'static str,
    value: f64,
    expected: &'static str,
) -> Result<(), Error> {
    if ok { Ok(()) } else { Err(Error::OutOfRange { name, value, expected }) }
}
