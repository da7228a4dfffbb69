//! A source image for bilinear samples.

use crate::Grey;

/// A source image: each word holds a pixel, its right, its lower, and its lower right neighbour,
/// from the lowest byte.
pub(crate) struct Source {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) words: Vec<u32>,
}

impl Source {
    pub(crate) fn new(grey: &Grey) -> Self {
        let Grey { width, height, pixels } = grey;
        let (width, height) = (*width, *height);
        let mut words = Vec::with_capacity(width * height);
        for y in 0..height {
            let row = &pixels[y * width..][..width];
            let below = &pixels[(y + 1).min(height - 1) * width..][..width];
            for x in 0..width {
                let right = (x + 1).min(width - 1);
                words.push(u32::from_le_bytes([row[x], row[right], below[x], below[right]]));
            }
        }
        Self { width, height, words }
    }

    /// Exclusive upper bounds of the positions of samples. Interpolation needs a right and a lower
    /// neighbour.
    pub(super) fn limits(&self) -> [f32; 2] {
        [self.width as f32 - 1.0, self.height as f32 - 1.0]
    }
}
