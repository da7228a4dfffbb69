//! Compressed descriptors, which give lower bounds of the distances of descriptors.
//!
//! An orthonormal transform preserves distances, and omitting coefficients does not increase them.
//! A descriptor has 4 × 4 histograms of 8 directions. A discrete cosine transform over rows and
//! columns and a Fourier transform over directions gathers 91 % of the variance of SIFT descriptors
//! in 56 of 128 coefficients. Their principal components have 94 %, but need training. Coefficients
//! are clamped to a box, which does not increase distances, and rounded to bytes. With a
//! quantisation step `q`, and with `e` the norm of the rounding error of a descriptor,
//!
//! `|a − b| ≥ q |â − b̂| − e_a − e_b`.

use tiepoint_features::SiftDescriptor;

use crate::packed::Packed;

/// Number of groups of four coefficients.
pub(crate) const COMPRESSED_GROUPS: usize = 14;
/// Number of coefficients.
const COEFFICIENTS: usize = 4 * COMPRESSED_GROUPS;

/// Quantisation step of the coefficients. The box is ±192 around the mean; the largest standard
/// deviation of a coefficient is 80.
const STEP: f32 = 1.5;
/// The byte of the mean.
const MEAN_BYTE: f32 = 128.0;
/// Upper bound of the floating-point rounding error of the coefficients, for any entries.
const ROUNDING: f64 = 0.25;

/// The kept coefficients, `8 (4 row + column) + direction`, in descending order of their variance
/// over rendered streets, a KITTI drive and fountain-P11.
const KEPT: [usize; COEFFICIENTS] = [
    9, 1, 3, 2, 34, 25, 17, 11, 4, 66, 42, 10, 35, 8, 74, 41, 36, 49, 12, 33, 50, 98, 0, 19, 32,
    44, 89, 43, 7, 5, 114, 106, 18, 73, 57, 82, 67, 16, 20, 81, 13, 52, 68, 51, 65, 40, 75, 21, 6,
    64, 76, 27, 38, 100, 14, 37,
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
        let mut centre = [MEAN_BYTE + 0.5; 128];
        for (coefficient, mean) in MEANS {
            centre[coefficient] -= mean / STEP;
        }
        let mut max_squared_error = 0.0_f32;
        let packed = Packed::new(descriptors.len(), |i| {
            let coefficients = transform(&descriptors[i]);
            let mut bytes = [[0; 4]; COMPRESSED_GROUPS];
            let mut squared_error = 0.0;
            for (byte, k) in bytes.as_flattened_mut().iter_mut().zip(KEPT) {
                // Rounds to the nearest step: `centre` includes half a step, and the cast
                // truncates.
                let shifted = (coefficients[k] / STEP + centre[k]).clamp(0.5, 255.5);
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

    /// The lower bound of the distances between descriptors of two images.
    pub(crate) fn bound(&self, other: &CompressedDescriptors) -> DistanceBound {
        DistanceBound { max_rounding: self.max_rounding + other.max_rounding }
    }
}

/// Maps squared distances of compressed descriptors to lower bounds of the squared distances of the
/// descriptors.
#[derive(Clone, Copy)]
pub(crate) struct DistanceBound {
    max_rounding: f64,
}

impl DistanceBound {
    /// The lower bound of the squared distance of two descriptors; `u32::MAX` for `u32::MAX`.
    pub(crate) fn of(self, compressed: u32) -> u32 {
        if compressed == u32::MAX {
            return u32::MAX;
        }
        let distance =
            (f64::from(STEP) * f64::from(compressed).sqrt() - self.max_rounding).max(0.0);
        (distance * distance) as u32
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
    fn bounds_do_not_exceed_distances() {
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
            let bound = compressed.bound(&compressed);
            for (i, a) in descriptors.iter().enumerate() {
                for (j, b) in descriptors.iter().enumerate() {
                    let squared: u32 = (0..COMPRESSED_GROUPS)
                        .flat_map(|g| {
                            let words = [i, j].map(|k| compressed.packed.word(k, g).to_le_bytes());
                            (0..4).map(move |k| u32::from(words[0][k].abs_diff(words[1][k])).pow(2))
                        })
                        .sum();
                    assert!(bound.of(squared) <= squared_distance(a, b), "{levels} {i} {j}");
                }
            }
        }
        assert_eq!(
            CompressedDescriptors::new(&[]).bound(&CompressedDescriptors::new(&[])).of(u32::MAX),
            u32::MAX
        );
    }
}
