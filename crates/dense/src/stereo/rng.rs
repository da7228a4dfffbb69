//! Random numbers of one pixel in one sweep.

/// SplitMix64 (Steele, Lea, Flood 2014), in single precision.
#[derive(Clone, Copy)]
pub(super) struct PixelRng(u64);

impl PixelRng {
    /// The stream of a pixel; `sweep` is a seed of the image, level and iteration.
    #[inline(always)]
    pub(super) fn new(sweep: u64, pixel: usize) -> Self {
        let mut rng = Self(sweep ^ (pixel as u64).wrapping_mul(0xD134_2543_DE82_EF95));
        rng.next();
        rng
    }

    #[inline(always)]
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Three uniform numbers in [−1, 1).
    #[inline(always)]
    pub(super) fn three(&mut self) -> [f32; 3] {
        let bits = self.next();
        [0, 21, 42].map(|shift| {
            let bits = (bits >> shift) & ((1 << 21) - 1);
            bits as f32 * (1.0 / (1 << 20) as f32) - 1.0
        })
    }
}
