//! The scale space of Lowe 2004, section 3: the Gaussian levels of the octaves.
//!
//! Octave `o` is sampled every 2^o pixels of the image. Its level `i` has σ_i = 1.6 · 2^(i/S)
//! samples, i = 0 … S + 2. Extrema of the differences D_i = L_{i+1} − L_i are detected at
//! i = 1 … S. Level i + 1 is level i blurred by √(σ_{i+1}² − σ_i²).
//!
//! The image is assumed to have σ = 0.5 pixels. Octave −1 is computed from the image doubled by
//! linear interpolation. Octave 0 is computed from the image and not from octave −1, so that
//! octave −1 need not be computed if coarser octaves give enough features. Lowe, VLFeat and COLMAP
//! compute every octave from the previous one. To give the same levels, the blur of octave 0
//! includes the blur of the interpolation, whose variance is 1/8 pixel²: the mean of the variances
//! of the kernels {1} and {½, ½} on the doubled grid, (0 + ¼) / 2. Level 0 of a later octave is
//! every second sample of level S of the previous octave, whose σ is twice that of its level 0.

/// σ of level 0, in samples of its octave.
pub(crate) const BASE_SIGMA: f64 = 1.6;
/// Assumed σ of the image, in pixels.
const IMAGE_SIGMA: f64 = 0.5;
/// Variance of linear interpolation at twice the resolution, in pixels² of the image.
const DOUBLING_VARIANCE: f64 = 0.125;
/// Radius of the kernels in σ, as in VLFeat. The Gaussian there is 0.03 % of its maximum.
const KERNEL_RADIUS_IN_SIGMA: f64 = 4.0;

/// The right half of a normalised Gaussian kernel: `[0]` is the centre.
pub(crate) type Kernel = Vec<f32>;

/// Gaussian weights for a blur of `sigma`.
fn gaussian(sigma: f64) -> Kernel {
    let radius = (KERNEL_RADIUS_IN_SIGMA * sigma).ceil().max(1.0) as usize;
    let half: Vec<f64> = (0..=radius).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp()).collect();
    let sum = half[0] + 2.0 * half[1..].iter().sum::<f64>();
    half.iter().map(|w| (w / sum) as f32).collect()
}

/// The blur from the image, or the doubled image, to level 0 of an octave.
pub(crate) fn kernel_from_image(octave: i32, first_octave: i32) -> Kernel {
    let scale = 2f64.powi(-octave);
    let mut variance = (IMAGE_SIGMA * scale).powi(2);
    if first_octave < 0 && octave == 0 {
        variance -= DOUBLING_VARIANCE;
    }
    gaussian((BASE_SIGMA.powi(2) - variance).sqrt())
}

/// The blurs between successive levels, from level 0 to level S + 2.
pub(crate) fn kernels_between_levels(levels: usize) -> Vec<Kernel> {
    let sigma = |i: usize| BASE_SIGMA * 2f64.powf(i as f64 / levels as f64);
    (0..levels + 2).map(|i| gaussian((sigma(i + 1).powi(2) - sigma(i).powi(2)).sqrt())).collect()
}

/// σ of a fractional level, in samples of its octave.
pub(crate) fn sigma_at(level: f64, levels: usize) -> f64 {
    BASE_SIGMA * 2f64.powf(level / levels as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_have_unit_sum_and_the_given_variance() {
        // Truncation at 4 σ removes 0.1 % of the variance. f32 weights and sampling change it by
        // less.
        const TOLERANCE: f64 = 2e-3;
        for sigma in [1.0, 1.226, 1.5604, 3.09, 5.0] {
            let k = gaussian(sigma);
            let sum: f64 = k
                .iter()
                .enumerate()
                .map(|(i, &w)| if i == 0 { 1.0 } else { 2.0 } * f64::from(w))
                .sum();
            let variance: f64 =
                k.iter().enumerate().map(|(i, &w)| 2.0 * (i * i) as f64 * f64::from(w)).sum();
            assert!((sum - 1.0).abs() < 1e-6, "{sum}");
            assert!((variance / (sigma * sigma) - 1.0).abs() < TOLERANCE, "{variance}");
        }
    }

    #[test]
    fn three_levels_have_the_radii_of_vlfeat() {
        let radii: Vec<usize> = kernels_between_levels(3).iter().map(|k| k.len() - 1).collect();
        assert_eq!(radii, [5, 7, 8, 10, 13]);
    }
}
