use std::path::PathBuf;

/// What can be wrong with a request, or with writing its result.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A number of the options is out of its range.
    #[error("{name} = {value} is out of range: {expected}")]
    OutOfRange {
        /// Which option.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        expected: &'static str,
    },
    /// Two corners of a route are too near for the radii of their turns.
    #[error(
        "corners {corner} and the next are {distance_m:.1} m apart, but their turns take \
        {needed_m:.1} m"
    )]
    CornersTooClose {
        /// Index of the first corner.
        corner: usize,
        /// How far they are apart.
        distance_m: f64,
        /// How far they would have to be.
        needed_m: f64,
    },
    /// A preset of that name does not exist.
    #[error("unknown {what} `{name}`: known are {known}")]
    UnknownName {
        /// What was asked for.
        what: &'static str,
        /// The name given.
        name: String,
        /// The names that exist.
        known: String,
    },
    /// A file could not be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// An image could not be encoded.
    #[error("cannot encode {path}: {reason}")]
    Encode {
        /// Which file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
}

/// `Ok` where `ok` holds of an option's value.
pub(crate) fn require(
    ok: bool,
    name: &'static str,
    value: f64,
    expected: &'static str,
) -> Result<(), Error> {
    if ok { Ok(()) } else { Err(Error::OutOfRange { name, value, expected }) }
}
