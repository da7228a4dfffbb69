//! A short form of descriptors that bounds their distances from below.
//!
//! An orthonormal transform does not change distances, and leaving coefficients out only shortens
//! them. A descriptor is 4 × 4 histograms of 8 directions: a discrete cosine transform over both
//! places and a Fourier transform over the directions gathers 91 % of the variance of SIFT
//! descriptors in 56 of 128 coefficients, nearly as much as their principal components (94 %), and
//! needs no training. Coefficients are cut to a box, which brings no two points further apart, and
//! rounded to bytes. With steps of `q`, and with `e` the length of what rounding took away,
//!
//! `|a − b| ≥ q |â − b̂| − e_a − e_b`.

use tiepoint_features::Descriptor;

use crate::packed::Packed;

/// Groups of four coefficients.
pub(crate) const SCREEN_GROUPS: usize = 14;
const COEFFICIENTS: usize = 4 * SCREEN_GROUPS;

/// Step of the coefficients: the box reaches ±192 around the middle, and the largest have a
/// standard deviation of 80.
const STEP: f32 = 1.5;
/// The byte that stands for the middle.
const MIDDLE: f32 = 128.0;
/// More than floating-point rounding of the coefficients can amount to, however large the entries.
const ROUNDING: f64 = 0.25;

/// Which coefficients, `8 (4 row + column) + direction`, in order of their variance over rendered
/// streets, a KITTI drive and fountain-P11.
const CHOSEN: [usize; COEFFICIENTS] = [
    9, 1, 3, 2, 34, 25, 17, 11, 4, 66, 42, 10, 35, 8, 74, 41, 36, 49, 12, 33, 50, 98, 0, 19, 32,
    44, 89, 43, 7, 5, 114, 106, 18, 73, 57, 82, 67, 16, 20, 81, 13, 52, 68, 51, 65, 40, 75, 21, 6,
    64, 76, 27, 38, 100, 14, 37,
];
/// Their means where these are not small.
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

/// The cosine transform of four numbers: cos π/8 and cos 3π/8 over √2.
const C1: f32 = 0.653_281_5;
const C3: f32 = 0.270_598_05;
const COSINES: [[f32; 4]; 4] =
    [[0.5, 0.5, 0.5, 0.5], [C1, C3, -C3, -C1], [0.5, -0.5, -0.5, 0.5], [C3, -C1, C1, -C3]];

/// The real Fourier transform of eight: 1/√8.
const R: f32 = 0.353_553_4;
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

/// The short forms of the descriptors of one image.
#[derive(Clone, Debug, Default)]
pub(crate) struct Screen {
    pub(crate) packed: Packed<SCREEN_GROUPS>,
    /// The greatest length that rounding took away.
    slack: f64,
}

impl Screen {
    pub(crate) fn new(descriptors: &[Descriptor]) -> Self {
        let mut centre = [MIDDLE + 0.5; 128];
        for (coefficient, mean) in MEANS {
            centre[coefficient] -= mean / STEP;
        }
        let mut most = 0.0_f32;
        let packed = Packed::new(descriptors.len(), |i| {
            let coefficients = transform(&descriptors[i]);
            let mut bytes = [[0; 4]; SCREEN_GROUPS];
            let mut lost = 0.0;
            for (byte, k) in bytes.as_flattened_mut().iter_mut().zip(CHOSEN) {
                // Half a step up, then down to the next step below.
                let place = (coefficients[k] / STEP + centre[k]).clamp(0.5, 255.5);
                *byte = place as u8;
                let rest = place - 0.5 - f32::from(*byte);
                lost += rest * rest;
            }
            most = most.max(lost);
            bytes
        });
        Screen { packed, slack: f64::from(STEP) * f64::from(most).sqrt() + ROUNDING }
    }

    /// How far apart descriptors of two images are at least.
    pub(crate) fn bound(&self, other: &Screen) -> Bound {
        Bound { slack: self.slack + other.slack }
    }
}

/// From squared distances of short forms to lower bounds of squared distances.
#[derive(Clone, Copy)]
pub(crate) struct Bound {
    slack: f64,
}

impl Bound {
    /// What the squared distance of two descriptors is at least; `u32::MAX` stays what it is.
    pub(crate) fn of(self, short: u32) -> u32 {
        if short == u32::MAX {
            return u32::MAX;
        }
        let distance = (f64::from(STEP) * f64::from(short).sqrt() - self.slack).max(0.0);
        (distance * distance) as u32
    }
}

fn transform(descriptor: &Descriptor) -> [f32; 128] {
    let mut by_direction = [[[0.0_f32; 8]; 4]; 4];
    for (place, cell) in descriptor.as_chunks::<8>().0.iter().enumerate() {
        let cell = cell.map(f32::from);
        for (wave, out) in WAVES.iter().zip(&mut by_direction[place / 4][place % 4]) {
            *out = wave.iter().zip(&cell).fold(0.0, |sum, (w, x)| sum + w * x);
        }
    }
    let mut by_column = [[[0.0_f32; 8]; 4]; 4];
    for (from, to) in by_direction.iter().zip(&mut by_column) {
        combine(from, to);
    }
    let mut by_row = [[0.0_f32; 32]; 4];
    combine(&by_column.map(|row| std::array::from_fn(|i| row[i / 8][i % 8])), &mut by_row);
    let mut all = [0.0; 128];
    all.copy_from_slice(by_row.as_flattened());
    all
}

/// The cosine transform of four vectors.
fn combine<const N: usize>(from: &[[f32; N]; 4], to: &mut [[f32; N]; 4]) {
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
    use crate::random::SplitMix64;

    #[test]
    fn the_transform_is_orthonormal() {
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
    fn no_two_descriptors_are_nearer_than_their_short_forms_say() {
        const COUNT: usize = 60;
        let mut random = SplitMix64::new(5, 0);
        // Any content; extremes only; little else than one direction.
        for levels in [256, 2, 7] {
            let mut byte = || (random.below(levels) * 255 / (levels - 1)) as u8;
            let mut descriptors: Vec<Descriptor> =
                (0..COUNT).map(|_| std::array::from_fn(|_| byte())).collect();
            for k in 0..COUNT / 2 {
                let mut near = descriptors[k];
                near[k] = near[k].wrapping_add(1 + k as u8 % 3);
                descriptors[COUNT / 2 + k] = near;
            }
            let screen = Screen::new(&descriptors);
            let bound = screen.bound(&screen);
            for (i, a) in descriptors.iter().enumerate() {
                for (j, b) in descriptors.iter().enumerate() {
                    let short: u32 = (0..SCREEN_GROUPS)
                        .flat_map(|g| {
                            let words = [i, j].map(|k| screen.packed.word(k, g).to_le_bytes());
                            (0..4).map(move |k| u32::from(words[0][k].abs_diff(words[1][k])).pow(2))
                        })
                        .sum();
                    assert!(bound.of(short) <= squared_distance(a, b), "{levels} {i} {j}");
                }
            }
        }
        assert_eq!(Screen::new(&[]).bound(&Screen::new(&[])).of(u32::MAX), u32::MAX);
    }
}
