//! Grey images of one byte a pixel, and their halves.

/// A grey image, by rows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Grey {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `width * height` bytes.
    pub pixels: Vec<u8>,
}

impl Grey {
    /// The luma of ITU-R BT.601 of interleaved red, green and blue bytes.
    pub fn from_rgb(width: usize, height: usize, rgb: &[u8]) -> Self {
        let luma = |rgb: &[u8]| {
            let [red, green, blue] = [rgb[0], rgb[1], rgb[2]].map(u32::from);
            // Weights in 2⁻¹⁶ that sum to one.
            ((19_595 * red + 38_470 * green + 7_471 * blue + (1 << 15)) >> 16) as u8
        };
        Self { width, height, pixels: rgb.chunks_exact(3).map(luma).collect() }
    }

    /// The image at half resolution: the means of 2 × 2 pixels. A last odd row or column is left
    /// out.
    pub(crate) fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mean = |index: usize| {
            let corner = 2 * (index / width) * self.width + 2 * (index % width);
            let at = |offset: usize| u32::from(self.pixels[corner + offset]);
            ((at(0) + at(1) + at(self.width) + at(self.width + 1) + 2) / 4) as u8
        };
        Self { width, height, pixels: (0..width * height).map(mean).collect() }
    }
}
