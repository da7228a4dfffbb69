//! What can be wrong with the input.

/// Why features could not be extracted.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The slice does not hold the pixels that the sizes promise.
    #[error(
        "a view of {width}x{height} pixels with rows {stride} apart needs {needed} bytes, the \
        slice has {len}"
    )]
    ViewTooShort {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Distance between rows, in pixels.
        stride: usize,
        /// Bytes that such a view spans.
        needed: usize,
        /// Bytes that the slice has.
        len: usize,
    },
    /// Rows overlap.
    #[error("rows of {width} pixels cannot lie {stride} pixels apart")]
    StrideTooSmall {
        /// Columns.
        width: usize,
        /// Distance between rows, in pixels.
        stride: usize,
    },
    /// The mask is not as large as the image.
    #[error(
        "the mask is {mask_width}x{mask_height} pixels, the image {width}x{height}: they must be \
        of one size"
    )]
    MaskSize {
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
        /// Columns of the mask.
        mask_width: usize,
        /// Rows of the mask.
        mask_height: usize,
    },
    /// An option is outside its range.
    #[error("option {name} is {value}, it must be {range}")]
    Option {
        /// The option.
        name: &'static str,
        /// What it was.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
}
