//! Random numbers of one pixel in one sweep.

use tiepoint_simd::Rng;

/// A stream in single precision.
pub(super) struct PixelRng(Rng);

impl PixelRng {
    /// The stream of a pixel; `sweep` is a seed of the image, level and iteration.
    #[inline(always)]
    pub(super) fn new(sweep: u64, pixel: usize) -> Self {
        let mut rng = Rng::from_state(sweep ^ (pixel as u64).wrapping_mul(0xD134_2543_DE82_EF95));
        rng.next_u64();
        Self(rng)
    }

    /// Three uniform numbers in [−1, 1).
    #[inline(always)]
    pub(super) fn three(&mut self) -> [f32; 3] {
        let bits = self.0.next_u64();
        [0, 21, 42].map(|shift| {
            let bits = (bits >> shift) & ((1 << 21) - 1);
            bits as f32 * (1.0 / (1 << 20) as f32) - 1.0
        })
    }
}
