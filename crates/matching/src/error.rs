//! The error type.

/// Errors of this crate: invalid input.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// The text is not a pair selection.
    #[error(
        "unknown pair selection \"{0}\": use auto, exhaustive, sequential:N, sequential:N+thin, \
        sequential:N+ends, sequential:N+loops:K or similar:K, for example sequential:20+loops:10"
    )]
    PairSelection(String),
    /// A sequence has different numbers of images and times.
    #[error(
        "a camera has {images} images but {times} times; give one time for each image, or none"
    )]
    TimeCount {
        /// Number of images of the camera.
        images: usize,
        /// Number of times.
        times: usize,
    },
    /// The times of a sequence are not finite or not in ascending order.
    #[error(
        "time {index} of a camera, {time_s} s, is not a finite number at or after the time before \
        it; sort the images by time"
    )]
    TimeOrder {
        /// Position in the sequence.
        index: usize,
        /// The invalid time, in seconds.
        time_s: f64,
    },
    /// An option is out of its range.
    #[error("{name} is {value}; it must be {range}")]
    Option {
        /// Name of the option.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Its range.
        range: &'static str,
    },
}
