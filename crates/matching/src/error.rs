//! What can be wrong with what a caller hands in.

/// Input that cannot be used, with the numbers that show why.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// The pair selection is not one of the known words.
    #[error(
        "unknown pair selection \"{0}\": use exhaustive, sequential:N, sequential:N+ends, \
        sequential:N+loops:K or similar:K, for \
         example sequential:20+loops:10"
    )]
    PairSelection(String),
    /// A sequence carries a list of times that does not fit its list of images.
    #[error(
        "a camera has {images} images but {times} times; give one time for each image, or none"
    )]
    TimeCount {
        /// How many images the camera has.
        images: usize,
        /// How many times came with them.
        times: usize,
    },
    /// Times must be finite and must not go backwards.
    #[error(
        "time {index} of a camera, {time_s} s, is not a finite number at or after the time before \
        it; sort the images by time"
    )]
    TimeOrder {
        /// Position in the camera's sequence.
        index: usize,
        /// The offending time in seconds.
        time_s: f64,
    },
    /// A pair names an image that does not exist.
    #[error("the pair {a}, {b} is outside of the {images} images")]
    PairRange {
        /// First image.
        a: u32,
        /// Second image.
        b: u32,
        /// How many images there are.
        images: u32,
    },
    /// An option is outside of its range.
    #[error("{name} is {value}; it must be {range}")]
    Option {
        /// The option's name.
        name: &'static str,
        /// What it was set to.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
}
