//! Sizes and units of patches and samples.

/// Cost of a patch with a sample outside of the source image: that of a correlation of −1.
pub(crate) const OUTSIDE: f32 = 2.0;
/// Number of samples of a patch.
pub(super) const SAMPLES: usize = 32;
/// Number of lanes of a sum.
pub(super) const LANES: usize = 16;
/// Steps of a position in a pixel.
pub(super) const STEPS: i32 = 64;
/// Units of an interpolated grey level.
pub(super) const UNITS: f32 = 16.0;
/// Subtracted from grey levels, so that sums of squares lose few bits.
pub(super) const MIDDLE: f32 = 2040.0;
/// Smallest variance of a patch: a standard deviation of half a grey level, twice that of rounding
/// to a byte. The correlation of a flatter patch is noise. Where contrast is low, half of this
/// deviation changes F1 by 0.2 %, and twice lowers it by 3 to 12 %; elsewhere both change nothing.
pub(super) const MIN_VARIANCE: f32 = 0.25 * UNITS * UNITS;
