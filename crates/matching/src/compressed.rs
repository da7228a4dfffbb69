//! Compressed descriptors, which give lower bounds of the distances of descriptors.
//!
//! An orthonormal transform preserves distances, and omitting coefficients does not increase them.
//! A descriptor has 4 × 4 histograms of 8 directions. A discrete cosine transform over rows and
//! columns and a Fourier transform over directions gathers 79 % of the variance of SIFT descriptors
//! in 32 of 128 coefficients. Coefficients are mapped to the nearest point of a ball and of a box,
//! which does not increase distances, and rounded to bytes. With a quantisation step `q`, and with
//! `e` the norm of the rounding error of a descriptor,
//!
//! `|a − b| ≥ q |â − b̂| − e_a − e_b`.

use tiepoint_features::SiftDescriptor;

use crate::packed::{MAX_ENTRY, MAX_SQUARE, Packed, centred_square};

/// Number of groups of four coefficients. On fountain-P11 two groups fewer compute 75 distances for
/// a row instead of 32, two more take 1.2 times as long for the sweep.
pub(crate) const COMPRESSED_GROUPS: usize = 8;
/// Number of coefficients.
const COEFFICIENTS: usize = 4 * COMPRESSED_GROUPS;

/// Quantisation step of the coefficients. The box is ±180 around the mean; the largest standard
/// deviation of a coefficient is 80. The ball has a radius of 354; less than 1 % of the descriptors
/// of photos are outside. Limits that shrink from column to column let 22 distances of a row be
/// computed with this step, 62 with half of it (most descriptors are outside), 31 with 3.5.
const STEP: f32 = 2.0;
/// The byte of the mean.
const MEAN_BYTE: f32 = 128.0;
/// Largest magnitude of a coefficient in steps, less than half a step below the next byte.
const BOX: f32 = MAX_ENTRY as f32 + 0.49;
/// Radius of the ball in steps. Rounding adds less than the root of `COEFFICIENTS`, halved.
const RADIUS: f32 = 177.0;
const _: () = assert!((RADIUS + 3.0) * (RADIUS + 3.0) < MAX_SQUARE as f32);
/// Upper bound of the floating-point rounding error of all coefficients of a descriptor, for any
/// entries: 22 roundings by 2⁻²⁴ of at most the norm 2885 times the root of 8 are 0.01.
const ROUNDING: f64 = 0.05;

/// The kept coefficients, `8 (4 row + column) + direction`, in descending order of their variance
/// over rendered streets, a KITTI drive and fountain-P11.
const KEPT: [usize; COEFFICIENTS] = [
    9, 1, 3, 2, 34, 25, 17, 11, 4, 66, 42, 10, 35, 8, 74, 41, 36, 49, 12, 33, 50, 98, 0, 19, 32,
    44, 89, 43, 7, 5, 114, 106,
];
/// Means of the coefficients whose mean is not small: (coefficient, mean).
const MEANS: [(usize, f32); 11] = [
    (0, 397.0),
    (1, 58.0),
    (3, 83.0),
    (5, 16.0),
    (7, 19.0),
    (16, -37.0),
    (17, -56.0),
    (19, -23.0),
    (21, -13.0),
    (42, 22.0),
    (67, -17.0),
];

/// cos(π/8) / √2, an entry of the cosine transform of four values.
const C1: f32 = 0.653_281_5;
/// cos(3π/8) / √2.
const C3: f32 = 0.270_598_05;
/// The orthonormal cosine transform of four values.
const COSINES: [[f32; 4]; 4] =
    [[0.5, 0.5, 0.5, 0.5], [C1, C3, -C3, -C1], [0.5, -0.5, -0.5, 0.5], [C3, -C1, C1, -C3]];

/// 1/√8, an entry of the real Fourier transform of eight values.
const R: f32 = 0.353_553_4;
/// The orthonormal real Fourier transform of eight values.
const WAVES: [[f32; 8]; 8] = [
    [R, R, R, R, R, R, R, R],
    [0.5, R, 0.0, -R, -0.5, -R, 0.0, R],
    [0.0, R, 0.5, R, 0.0, -R, -0.5, -R],
    [0.5, 0.0, -0.5, 0.0, 0.5, 0.0, -0.5, 0.0],
    [0.0, 0.5, 0.0, -0.5, 0.0, 0.5, 0.0, -0.5],
    [0.5, -R, 0.0, R, -0.5, R, 0.0, -R],
    [0.0, R, -0.5, R, 0.0, -R, 0.5, -R],
    [R, -R, R, -R, R, -R, R, -R],
];

/// The compressed descriptors of an image.
#[derive(Clone, Debug, Default)]
pub(crate) struct CompressedDescriptors {
    pub(crate) packed: Packed<COMPRESSED_GROUPS>,
    /// Upper bound of the norm of the rounding error of a descriptor.
    max_rounding: f64,
}

impl CompressedDescriptors {
    pub(crate) fn new(descriptors: &[SiftDescriptor]) -> Self {
        let mut mean = [0.0; 128];
        for (coefficient, value) in MEANS {
            mean[coefficient] = value;
        }
        let mut max_squared_error = 0.0_f32;
        let packed = Packed::new(descriptors.len(), MEAN_BYTE as u8, |i| {
            let coefficients = transform(&descriptors[i]);
            let mut steps = [0.0; COEFFICIENTS];
            for (step, k) in steps.iter_mut().zip(KEPT) {
                *step = (coefficients[k] - mean[k]) / STEP;
            }
            let norm = steps.iter().fold(0.0, |sum, step| sum + step * step).sqrt();
            let scale = if norm > RADIUS { RADIUS / norm } else { 1.0 };
            let mut bytes = [[0; 4]; COMPRESSED_GROUPS];
            let mut squared_error = 0.0;
            for (byte, step) in bytes.as_flattened_mut().iter_mut().zip(steps) {
                // Rounds to the nearest step, because the cast truncates.
                let shifted = (step * scale).clamp(-BOX, BOX) + (MEAN_BYTE + 0.5);
                *byte = shifted as u8;
                let error = shifted - 0.5 - f32::from(*byte);
                squared_error += error * error;
            }
            max_squared_error = max_squared_error.max(squared_error);
            bytes
        });
        let max_rounding = f64::from(STEP) * f64::from(max_squared_error).sqrt() + ROUNDING;
        CompressedDescriptors { packed, max_rounding }
    }

    /// The scores of the descriptors of another image as candidates for those of this one.
    pub(crate) fn scores(&self, other: &CompressedDescriptors) -> Scores<'_> {
        Scores { terms: &self.packed.terms, rounding: self.max_rounding + other.max_rounding }
    }
}

/// The scores of candidates (`brute::screen`).
pub(crate) struct Scores<'a> {
    terms: &'a [i32],
    rounding: f64,
}

impl Scores<'_> {
    /// A lower bound of the scores of all descriptors whose squared distance to descriptor `row` is
    /// at most `limit`; `i32::MAX` for a negative limit.
    pub(crate) fn least(&self, row: u32, limit: f64) -> i32 {
        if limit < 0.0 {
            return i32::MAX;
        }
        let reach = (limit.sqrt() + self.rounding) / f64::from(STEP);
        let square = centred_square::<COMPRESSED_GROUPS>(self.terms[row as usize]);
        // The cast truncates.
        (0.5 * (f64::from(square) - reach * reach) - 1.0) as i32
    }
}

/// The coefficients of a descriptor.
fn transform(descriptor: &SiftDescriptor) -> [f32; 128] {
    let mut by_direction = [[[0.0_f32; 8]; 4]; 4];
    for (place, cell) in descriptor.as_chunks::<8>().0.iter().enumerate() {
        let cell = cell.map(f32::from);
        for (wave, out) in WAVES.iter().zip(&mut by_direction[place / 4][place % 4]) {
            *out = wave.iter().zip(&cell).fold(0.0, |sum, (w, x)| sum + w * x);
        }
    }
    let mut by_column = [[[0.0_f32; 8]; 4]; 4];
    for (from, to) in by_direction.iter().zip(&mut by_column) {
        cosine_transform(from, to);
    }
    let mut by_row = [[0.0_f32; 32]; 4];
    cosine_transform(&by_column.map(|row| std::array::from_fn(|i| row[i / 8][i % 8])), &mut by_row);
    let mut all = [0.0; 128];
    all.copy_from_slice(by_row.as_flattened());
    all
}

/// The cosine transform of four vectors.
fn cosine_transform<const N: usize>(from: &[[f32; N]; 4], to: &mut [[f32; N]; 4]) {
    for (cosines, to) in COSINES.iter().zip(to) {
        for (cosine, from) in cosines.iter().zip(from) {
            for (to, from) in to.iter_mut().zip(from) {
                *to += cosine * from;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::distance::squared_distance;
    use crate::packed::Vectors;
    use crate::random::stream;

    #[test]
    fn transform_is_orthonormal() {
        let unit = |k: usize| -> [f32; 128] {
            let mut descriptor = [0; 128];
            descriptor[k] = 1;
            transform(&descriptor)
        };
        for i in 0..128 {
            for j in 0..128 {
                let product: f32 = unit(i).iter().zip(unit(j)).map(|(x, y)| x * y).sum();
                assert!((product - f32::from(u8::from(i == j))).abs() < 1e-6, "{i} {j} {product}");
            }
        }
    }

    #[test]
    fn near_descriptors_have_large_scores() {
        const COUNT: usize = 60;
        let mut random = stream(5, 0);
        // All byte values; the two extreme values only; seven values.
        for levels in [256, 2, 7] {
            let mut byte = || (random.below(levels) * 255 / (levels - 1)) as u8;
            let mut descriptors: Vec<SiftDescriptor> =
                (0..COUNT).map(|_| std::array::from_fn(|_| byte())).collect();
            for k in 0..COUNT / 2 {
                let mut near = descriptors[k];
                near[k] = near[k].wrapping_add(1 + k as u8 % 3);
                descriptors[COUNT / 2 + k] = near;
            }
            let compressed = CompressedDescriptors::new(&descriptors);
            let scores = compressed.scores(&compressed);
            let centred = |k: usize| -> [i32; COEFFICIENTS] {
                std::array::from_fn(|at| {
                    let word = compressed.packed.word(k, at / 4).to_le_bytes();
                    i32::from(word[at % 4]) - MEAN_BYTE as i32
                })
            };
            let product = |i: usize, j: usize| -> i32 {
                centred(i).iter().zip(centred(j)).map(|(x, y)| x * y).sum()
            };
            for (i, a) in descriptors.iter().enumerate() {
                assert!(centred(i).iter().all(|x| x.abs() <= MAX_ENTRY), "{levels} {i}");
                assert!(product(i, i) <= MAX_SQUARE, "{levels} {i}");
                assert_eq!(scores.least(i as u32, -1.0), i32::MAX);
                assert!(scores.least(i as u32, f64::INFINITY) < -2 * MAX_SQUARE);
                for (j, b) in descriptors.iter().enumerate() {
                    let least = scores.least(i as u32, squared_distance(a, b).into());
                    assert!(least <= product(i, j) - product(j, j) / 2, "{levels} {i} {j}");
                }
            }
        }
    }
}
