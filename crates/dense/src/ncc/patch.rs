//! Patches of the reference image.

use super::constants::{LANES, MIDDLE, MIN_VARIANCE, SAMPLES, UNITS};
use crate::Grey;

/// The pixels within √10 of the centre except the five in the middle: 7 pixels wide, and the 32
/// samples fill the lanes. Like all constants of this crate, chosen on two synthetic scenes that
/// are not benchmarked; `docs/benchmarks/dense.md` has the accuracy with other values.
const OFFSETS: [[i32; 2]; SAMPLES] = offsets();
/// Standard deviation of the bilateral weights in space, in pixels: the radius of the patch, as in
/// Schönberger 2016. Half and twice of it change F1 by at most 0.3 %.
const SPATIAL_SIGMA: f64 = 3.0;
/// Standard deviation of the bilateral weights in grey levels: a quarter of that of Schönberger
/// 2016, so that pixels of another surface count less. Half of it raises F1 by 1.3 % in a room and
/// lowers it by 1.1 % on a noisy street; twice of it lowers F1 by up to 2.5 %.
const GREY_SIGMA: f64 = 0.05 * 255.0;
/// Largest offset.
pub(crate) const RADIUS: usize = 3;

const fn offsets() -> [[i32; 2]; SAMPLES] {
    let mut offsets = [[0; 2]; SAMPLES];
    let radius = RADIUS as i32;
    let (mut count, mut y) = (0, -radius);
    while y <= radius {
        let mut x = -radius;
        while x <= radius {
            let squared = x * x + y * y;
            if 1 < squared && squared <= 10 {
                offsets[count] = [x, y];
                count += 1;
            }
            x += 1;
        }
        y += 1;
    }
    assert!(count == SAMPLES);
    offsets
}

const fn lanes(axis: usize) -> [[f32; LANES]; 2] {
    let mut lanes = [[0.0; LANES]; 2];
    let mut sample = 0;
    while sample < SAMPLES {
        lanes[sample / LANES][sample % LANES] = OFFSETS[sample][axis] as f32;
        sample += 1;
    }
    lanes
}

/// Offsets of the samples from the centre of the patch, in pixels.
pub(super) static DX: [[f32; LANES]; 2] = lanes(0);
pub(super) static DY: [[f32; LANES]; 2] = lanes(1);

/// Weights and grey levels of a patch.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(crate) struct Patch {
    /// Weights that sum to one.
    pub(super) weights: [[f32; LANES]; 2],
    /// Weights times grey levels minus their weighted mean.
    pub(super) centred: [[f32; LANES]; 2],
    /// 1 / standard deviation of the grey levels.
    pub(super) inverse_deviation: f32,
}

/// Tables for patches of an image.
pub(crate) struct PatchTable {
    spatial: [f32; SAMPLES],
    by_difference: [f32; 256],
    /// Index of each sample relative to the centre.
    steps: [isize; SAMPLES],
}

impl PatchTable {
    pub(crate) fn new(width: usize) -> Self {
        let gauss = |squared: f64, sigma: f64| (-squared / (2.0 * sigma * sigma)).exp() as f32;
        let spatial = |[dx, dy]: [i32; 2]| gauss(f64::from(dx * dx + dy * dy), SPATIAL_SIGMA);
        Self {
            spatial: OFFSETS.map(spatial),
            by_difference: std::array::from_fn(|d| gauss((d * d) as f64, GREY_SIGMA)),
            steps: OFFSETS.map(|[dx, dy]| dx as isize + dy as isize * width as isize),
        }
    }

    /// The patch around a pixel; `None` if its grey levels vary too little. Beyond the border, the
    /// pixels of the border are repeated.
    #[inline(always)]
    pub(crate) fn patch(&self, grey: &Grey, x: usize, y: usize) -> Option<Patch> {
        let Grey { width, height, pixels } = grey;
        let index = y * width + x;
        let middle = pixels[index];
        let is_inside = x >= RADIUS && y >= RADIUS && x + RADIUS < *width && y + RADIUS < *height;
        let mut levels = [0; SAMPLES];
        if is_inside {
            for (level, step) in levels.iter_mut().zip(self.steps) {
                *level = pixels[index.wrapping_add_signed(step)];
            }
        } else {
            for (level, [dx, dy]) in levels.iter_mut().zip(OFFSETS) {
                let x = x.saturating_add_signed(dx as isize).min(width - 1);
                let y = y.saturating_add_signed(dy as isize).min(height - 1);
                *level = pixels[y * width + x];
            }
        }
        // Sums run over lanes, like those of the kernels.
        let mut weights = [[0.0; LANES]; 2];
        let mut values = [[0.0; LANES]; 2];
        for half in 0..2 {
            for lane in 0..LANES {
                let level = levels[half * LANES + lane];
                let by_difference = self.by_difference[usize::from(level.abs_diff(middle))];
                weights[half][lane] = self.spatial[half * LANES + lane] * by_difference;
                values[half][lane] = UNITS * f32::from(level) - MIDDLE;
            }
        }
        let total = sum(|half, lane| weights[half][lane]);
        let scale = 1.0 / total;
        let mean = scale * sum(|half, lane| weights[half][lane] * values[half][lane]);
        let mut centred = [[0.0; LANES]; 2];
        for half in 0..2 {
            for lane in 0..LANES {
                weights[half][lane] *= scale;
                values[half][lane] -= mean;
                centred[half][lane] = weights[half][lane] * values[half][lane];
            }
        }
        let variance = sum(|half, lane| centred[half][lane] * values[half][lane]);
        let patch = Patch { weights, centred, inverse_deviation: 1.0 / variance.sqrt() };
        (variance >= MIN_VARIANCE).then_some(patch)
    }
}

/// The sum over all samples: of each lane, then halves are added until one is left.
#[inline(always)]
fn sum(of: impl Fn(usize, usize) -> f32) -> f32 {
    let mut lanes: [f32; LANES] = std::array::from_fn(|lane| of(0, lane) + of(1, lane));
    let mut width = LANES / 2;
    while width > 0 {
        for lane in 0..width {
            lanes[lane] += lanes[lane + width];
        }
        width /= 2;
    }
    lanes[0]
}
