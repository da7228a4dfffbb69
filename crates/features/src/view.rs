//! Borrowed grey images.

use crate::Error;

/// A borrowed grey image of 8 bits per pixel.
#[derive(Clone, Copy, Debug)]
pub struct GrayView<'a> {
    /// The pixels, row after row.
    pub data: &'a [u8],
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Distance from the start of one row to the start of the next, in pixels.
    pub stride: usize,
}

impl<'a> GrayView<'a> {
    /// A view of an image whose stride is its width.
    pub fn new(data: &'a [u8], width: usize, height: usize) -> Self {
        GrayView { data, width, height, stride: width }
    }

    /// Checks that the slice holds all pixels and that rows do not overlap.
    pub(crate) fn check(&self) -> Result<(), Error> {
        let GrayView { data, width, height, stride } = *self;
        if width == 0 || height == 0 {
            return Ok(());
        }
        if stride < width {
            return Err(Error::StrideTooSmall { width, stride });
        }
        let needed = (height - 1).saturating_mul(stride).saturating_add(width);
        if data.len() < needed {
            return Err(Error::ViewTooShort { width, height, stride, needed, len: data.len() });
        }
        Ok(())
    }

    /// The pixels of row `y`.
    pub(crate) fn row(&self, y: usize) -> &'a [u8] {
        &self.data[y * self.stride..][..self.width]
    }
}
