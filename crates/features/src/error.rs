//! The error type.

use crate::DescriptorFormat;

/// Errors of feature extraction.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The slice is too short for width, height and stride.
    #[error(
        "an image view of {width}x{height} pixels with a stride of {stride} needs {needed} bytes, \
        but the slice has {len}"
    )]
    ViewTooShort {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Distance between rows, in pixels.
        stride: usize,
        /// Number of bytes that the view needs.
        needed: usize,
        /// Number of bytes of the slice.
        len: usize,
    },
    /// The stride is smaller than the width.
    #[error(
        "the stride of an image view, {stride} pixels, is smaller than its width, {width} pixels"
    )]
    StrideTooSmall {
        /// Columns.
        width: usize,
        /// Distance between rows, in pixels.
        stride: usize,
    },
    /// The mask and the image have different sizes.
    #[error(
        "the mask has {mask_width}x{mask_height} pixels and the image {width}x{height}: they must \
        have the same size"
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
        /// Name of the option.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Its range.
        range: &'static str,
    },
    /// Entries do not make descriptors of a format.
    #[error("descriptors of {format} cannot have {count} {entries} in all")]
    Descriptors {
        /// The format.
        format: DescriptorFormat,
        /// Number of entries.
        count: usize,
        /// What they are: bytes or floats.
        entries: &'static str,
    },
}
