//! Procedural patterns on a plane, averaged over the footprint of a pixel.
//!
//! Every pattern takes the width of the footprint and returns its mean over it: exactly if there is
//! a closed form (lines, cells); otherwise (noise) each octave fades out before it aliases.
//! Textures are therefore anti-aliased at every distance without mipmaps, and edges are at their
//! exact positions.

use tiepoint_simd::dispatch;

/// Mean of patterns with values in −1..1.
const MEAN: f32 = 0.0;

/// A hash of 32 bits of a lattice point.
pub(crate) fn hash(x: i32, y: i32, seed: u32) -> u32 {
    let mut h = (x as u32).wrapping_mul(0x8DA6_B343)
        ^ (y as u32).wrapping_mul(0xD816_3841)
        ^ seed.wrapping_mul(0xCB1A_B31F);
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    h ^ (h >> 15)
}

/// Bits as a number in −1..1.
pub(crate) fn signed(bits: u32) -> f32 {
    (bits >> 8) as f32 * (2.0 / (1u32 << 24) as f32) - 1.0
}

/// Bits as a number in 0..1.
pub(crate) fn unsigned(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / (1u32 << 24) as f32)
}

pub(crate) fn smoothstep(x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// `x.floor()` for numbers that fit 32 bits; without SSE 4.1 the standard function is a library
/// call.
#[inline(always)]
pub(crate) fn floor(x: f64) -> i32 {
    whole(x).0
}

/// The floor of `x` as an integer and as a float. Adding 1.5 · 2⁵² rounds `x` to an integer, which
/// is then in the low bits of the sum. A cast would check the range.
#[inline(always)]
fn whole(x: f64) -> (i32, f64) {
    const LARGE: f64 = 1.5 * (1u64 << 52) as f64;
    let sum = x + LARGE;
    let (bits, rounded) = (sum.to_bits() as i32, sum - LARGE);
    let excess = i32::from(rounded > x);
    (bits - excess, rounded - f64::from(excess))
}

#[inline(always)]
fn lattice(x: f64) -> (i32, f32) {
    let (whole, below) = whole(x);
    (whole, (x - below) as f32)
}

/// A footprint is split along its length if its length exceeds this multiple of its width, into at
/// most so many parts.
const SPLIT: f64 = 2.0;
const MAX_PARTS: f64 = 4.0;

/// The footprint of a pixel on a surface: a parallelogram, described by its longer side.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Footprint {
    long: [f64; 2],
    length: f64,
    width: f64,
    /// Extent of the shorter side along each axis.
    short: [f64; 2],
}

impl Footprint {
    /// From the steps on the surface to the next pixel on the right and below, in metres.
    pub(crate) fn new(right: [f64; 2], down: [f64; 2]) -> Self {
        let length = |step: [f64; 2]| (step[0] * step[0] + step[1] * step[1]).sqrt();
        let (mut long, mut short) = ((right, length(right)), (down, length(down)));
        if long.1 < short.1 {
            (long, short) = (short, long);
        }
        Self {
            long: long.0,
            length: long.1,
            width: short.1.max(1e-6),
            short: short.0.map(f64::abs),
        }
    }

    /// Upper bound of its extent.
    pub(crate) fn reach(&self) -> f64 {
        self.length + self.width
    }

    /// The number of parts along its length, such that no part is finer than `fineness`, and the
    /// width of a part.
    fn divide(&self, fineness: f64) -> (usize, f64) {
        let undivided = (SPLIT * self.width).max(fineness);
        if self.length <= undivided {
            return (1, self.length.max(self.width));
        }
        let parts = (self.length / undivided).min(MAX_PARTS).ceil();
        (parts as usize, (self.length / parts).max(self.width))
    }

    /// Centre of a part along the length, −½ to ½.
    fn middle(part: usize, parts: usize) -> f64 {
        (part as f64 + 0.5) / parts as f64 - 0.5
    }

    /// Mean of a function of (offset, width, width along each axis) over the parts.
    #[inline(always)]
    pub(crate) fn mean<const N: usize>(
        &self,
        fineness: f64,
        f: impl Fn([f64; 2], f64, [f64; 2]) -> [f32; N],
    ) -> [f32; N] {
        let (parts, width) = self.divide(fineness);
        if parts == 1 {
            let axes = [0, 1].map(|axis| self.long[axis].abs() + self.short[axis]);
            return f([0.0; 2], width, axes);
        }
        let axes = [0, 1].map(|axis| self.long[axis].abs() / parts as f64 + self.short[axis]);
        let mut sum = [0.0f32; N];
        for part in 0..parts {
            let along = Self::middle(part, parts);
            let value = f(self.long.map(|step| step * along), width, axes);
            sum = std::array::from_fn(|k| sum[k] + value[k]);
        }
        sum.map(|sum| sum / parts as f32)
    }
}

/// One octave of value noise: random values at lattice points, smoothly interpolated, in −1..1.
#[inline(always)]
fn value_noise(x: f64, y: f64, seed: u32) -> f32 {
    let ((ix, fx), (iy, fy)) = (lattice(x), lattice(y));
    let (sx, sy) = (fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy));
    // A shorter hash suffices; the four corners of a cell share its first part.
    let [x0, y0] = [(ix as u32).wrapping_mul(0x8DA6_B343), (iy as u32).wrapping_mul(0xD816_3841)];
    let [x1, y1] = [x0.wrapping_add(0x8DA6_B343), y0.wrapping_add(0xD816_3841)];
    let salt = seed.wrapping_mul(0xCB1A_B31F);
    let corners = [x0 ^ y0, x1 ^ y0, x0 ^ y1, x1 ^ y1].map(|h| {
        let h = h ^ salt;
        let h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
        ((h ^ (h >> 14)) >> 8) as i32 as f32
    });
    let (bottom, top) =
        (corners[0] + sx * (corners[1] - corners[0]), corners[2] + sx * (corners[3] - corners[2]));
    (bottom + sy * (top - bottom)) * (2.0 / (1u32 << 24) as f32) - 1.0
}

/// Number of positions at which noise is evaluated together: the lanes of the widest vectors.
const LANES: usize = 8;

dispatch! {
    /// Value noise at eight positions.
    fn value_noises(places: &Places) -> [f32; LANES] {
        value_noises_here(places)
    }
}

#[inline(always)]
fn value_noises_here(places: &Places) -> [f32; LANES] {
    std::array::from_fn(|k| value_noise(places.x[k], places.y[k], places.seed[k]))
}

/// Positions and seeds of an evaluation.
#[derive(Clone, Copy, Default)]
struct Places {
    x: [f64; LANES],
    y: [f64; LANES],
    seed: [u32; LANES],
}

const MAX_OCTAVES: usize = 6;
/// Vectors of positions in one sum: octaves times parts.
const MAX_BATCHES: usize = 3;

/// Size of the blobs of an octave relative to the previous one.
const LACUNARITY: f64 = 0.43;

/// Fractal value noise: octaves from the blob size `coarsest` downwards. An octave fades out before
/// its blobs are as small as the footprint.
pub(crate) struct Fractal {
    pub(crate) coarsest: f64,
    /// At most [`MAX_OCTAVES`].
    pub(crate) octaves: u32,
    /// Amplitude of each octave relative to the previous one.
    pub(crate) persistence: f32,
}

impl Fractal {
    /// The noise at a position, about −1..1. Coarse octaves are evaluated only at the centre of a
    /// long footprint, along which they are constant.
    pub(crate) fn at(&self, [u, v]: [f64; 2], footprint: &Footprint, seed: u32) -> f32 {
        const { assert!(MAX_OCTAVES * MAX_PARTS as usize <= MAX_BATCHES * LANES) };
        debug_assert!(self.octaves as usize <= MAX_OCTAVES);
        let mut places = [Places::default(); MAX_BATCHES];
        let mut count = 0;
        // For each visible octave: its weight, and the end of its positions in the list.
        let mut octaves = [(0.0f32, 0usize); MAX_OCTAVES];
        let (mut amplitude, mut size, mut inverse) = (1.0, self.coarsest, 1.0 / self.coarsest);
        let mut num_octaves = 0;
        for octave in 0..self.octaves {
            if size <= footprint.width {
                break;
            }
            let (parts, width) = footprint.divide(size * (1.0 / 3.0));
            if size > width {
                // Full above three footprints, nothing at one.
                let fade = if size >= 3.0 * width {
                    1.0
                } else {
                    smoothstep(((size / width - 1.0) * 0.5) as f32)
                };
                for part in 0..parts {
                    let along = if parts == 1 { 0.0 } else { Footprint::middle(part, parts) };
                    let [x, y] = [u + footprint.long[0] * along, v + footprint.long[1] * along];
                    let (batch, lane) = (&mut places[count / LANES], count % LANES);
                    (batch.x[lane], batch.y[lane]) = (x * inverse, y * inverse);
                    batch.seed[lane] = seed.wrapping_add(octave);
                    count += 1;
                }
                octaves[num_octaves] = (amplitude * fade / parts as f32, count);
                num_octaves += 1;
            }
            amplitude *= self.persistence;
            size *= LACUNARITY;
            inverse *= 1.0 / LACUNARITY;
        }
        let mut values = [[0.0f32; LANES]; MAX_BATCHES];
        for (values, places) in values.iter_mut().zip(&places[..count.div_ceil(LANES)]) {
            *values = value_noises(places);
        }
        let values = values.as_flattened();
        let (mut sum, mut start) = (0.0, 0);
        for &(weight, end) in &octaves[..num_octaves] {
            sum += weight * values[start..end].iter().sum::<f32>();
            start = end;
        }
        sum
    }
}

/// Fraction of the interval `x ± width/2` in lines of thickness `line` that begin at every multiple
/// of `period`.
pub(crate) fn lines(x: f64, width: f64, period: f64, line: f64) -> f32 {
    let integral = |x: f64| {
        let turns = f64::from(floor(x / period));
        turns * line + (x - turns * period).min(line)
    };
    let width = width.max(1e-6);
    ((integral(x + 0.5 * width) - integral(x - 0.5 * width)) / width) as f32
}

/// Fraction of the interval `x ± width/2` in `from..to`.
pub(crate) fn interval(x: f64, width: f64, from: f64, to: f64) -> f32 {
    let width = width.max(1e-6);
    let (low, high) = ((x - 0.5 * width).max(from), (x + 0.5 * width).min(to));
    ((high - low).max(0.0) / width) as f32
}

/// Mean over the footprint of a function that is constant on unit cells: exact up to a footprint of
/// one cell; for larger ones it fades to `mean`.
pub(crate) fn cells(
    [x, y]: [f64; 2],
    [width_x, width_y]: [f64; 2],
    mean: f32,
    value: impl Fn(i32, i32) -> f32,
) -> f32 {
    let fade = smoothstep((2.0 - width_x.max(width_y)) as f32);
    if fade <= 0.0 {
        return mean;
    }
    let along = |x: f64, width: f64| {
        let width = width.clamp(1e-6, 1.0);
        let low = floor(x - 0.5 * width);
        // Fraction of the footprint in the cell after `low`.
        let share = ((x + 0.5 * width - f64::from(low) - 1.0) / width).clamp(0.0, 1.0);
        (low, share as f32)
    };
    let ((ix, sx), (iy, sy)) = (along(x, width_x), along(y, width_y));
    let mut sum = 0.0;
    for (dx, weight_x) in [(0, 1.0 - sx), (1, sx)] {
        for (dy, weight_y) in [(0, 1.0 - sy), (1, sy)] {
            if weight_x * weight_y > 0.0 {
                sum += weight_x * weight_y * value(ix.wrapping_add(dx), iy.wrapping_add(dy));
            }
        }
    }
    mean + fade * (sum - mean)
}

/// Round spots, darker or lighter (−1..1), at most one in a cell of side `size`, in the fraction
/// `share` of the cells.
pub(crate) fn spots(
    [u, v]: [f64; 2],
    footprint: &Footprint,
    size: f64,
    share: f32,
    seed: u32,
) -> f32 {
    if footprint.width > size {
        return MEAN;
    }
    let inverse = 1.0 / size;
    // The edge of a large spot may be slightly too soft in a long footprint.
    let [mean] = footprint.mean(size * 0.1, |offset, width, _| {
        [spot([(u + offset[0]) * inverse, (v + offset[1]) * inverse], width * inverse, share, seed)]
    });
    mean
}

/// Spots in a lattice of unit cells.
fn spot([u, v]: [f64; 2], width: f64, share: f32, seed: u32) -> f32 {
    let ((ix, fx), (iy, fy)) = (lattice(u), lattice(v));
    let bits = hash(ix, iy, seed);
    if unsigned(bits) > share {
        return MEAN;
    }
    let more = hash(iy, ix, seed ^ 0x5BD1_E995);
    let radius = 0.12 + 0.2 * (more & 0xFF) as f32 / 255.0;
    let place = |bits: u32| radius + (1.0 - 2.0 * radius) * (bits & 0xFF) as f32 / 255.0;
    let (dx, dy) = (fx - place(more >> 8), fy - place(more >> 16));
    let edge = width as f32;
    let stretch = 0.6 + 0.8 * (more >> 24) as f32 / 255.0;
    let inside = (radius - (dx * dx + dy * dy * stretch * stretch).sqrt() / stretch.max(1.0))
        / edge.max(1e-4)
        + 0.5;
    // Spots fade out when the footprint exceeds their radius.
    let fade = smoothstep(2.0 - edge / radius);
    fade * inside.clamp(0.0, 1.0) * signed(bits.wrapping_mul(0x9E37_79B9))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Samples of a numerical mean along one axis; its relative error is about the inverse.
    const SAMPLES: usize = 400;
    const TOLERANCE: f32 = 0.01;

    fn slow_mean(x: f64, width: f64, f: impl Fn(f64) -> f32) -> f32 {
        let sum: f32 =
            (0..SAMPLES).map(|k| f(x + width * ((k as f64 + 0.5) / SAMPLES as f64 - 0.5))).sum();
        sum / SAMPLES as f32
    }

    proptest! {
        #[test]
        fn floor_equals_the_standard_function(x in -2e9..2e9, near in -9i32..9) {
            prop_assert_eq!(floor(x), x.floor() as i32);
            for at in [
                f64::from(near),
                f64::from(near) + 0.5,
                f64::from(near).next_down(),
                f64::from(near).next_up(),
            ] {
                prop_assert_eq!(floor(at), at.floor() as i32);
            }
        }

        #[test]
        fn lines_and_intervals_equal_numerical_means(
            x in -5.0..5.0,
            width in 0.01..3.0,
            line in 0.05..0.6,
        ) {
            let exact = lines(x, width, 0.7, line);
            let slow = slow_mean(x, width, |x| f32::from(x.rem_euclid(0.7) < line));
            prop_assert!((exact - slow).abs() < TOLERANCE, "{exact} {slow}");
            let exact = interval(x, width, -1.0, line);
            let slow = slow_mean(x, width, |x| f32::from((-1.0..line).contains(&x)));
            prop_assert!((exact - slow).abs() < TOLERANCE, "{exact} {slow}");
        }

        #[test]
        fn cells_equal_numerical_means(
            x in -5.0..5.0,
            y in -5.0..5.0,
            wx in 0.01..1.0,
            wy in 0.01..1.0,
        ) {
            let value = |ix: i32, iy: i32| signed(hash(ix, iy, 3));
            let exact = cells([x, y], [wx, wy], 0.0, value);
            let slow = slow_mean(y, wy, |y| {
                slow_mean(x, wx, |x| value(x.floor() as i32, y.floor() as i32))
            });
            prop_assert!((exact - slow).abs() < 2.0 * TOLERANCE, "{exact} {slow}");
        }

        #[test]
        fn vector_code_computes_the_same_bits(
            x: [i16; LANES],
            y: [i16; LANES],
            seed: [u32; LANES],
            size in 0.01..3.0,
        ) {
            let places = Places {
                x: x.map(|x| f64::from(x) * size),
                y: y.map(|y| f64::from(y) * size),
                seed,
            };
            let alone: [f32; LANES] =
                std::array::from_fn(|k| value_noise(places.x[k], places.y[k], seed[k]));
            prop_assert_eq!(value_noises(&places).map(f32::to_bits), alone.map(f32::to_bits));
        }

        #[test]
        fn patterns_vanish_in_large_footprints(
            u in -9.0..9.0,
            v in -9.0..9.0,
            seed: u32,
        ) {
            let fractal = Fractal { coarsest: 0.5, octaves: 6, persistence: 0.8 };
            let footprint = Footprint::new([0.6, 0.0], [0.0, 0.6]);
            prop_assert_eq!(fractal.at([u, v], &footprint, seed), 0.0);
            prop_assert_eq!(cells([u, v], [2.5, 0.1], 0.25, |_, _| 1.0), 0.25);
            prop_assert_eq!(spots([u, v], &footprint, 0.2, 1.0, seed), 0.0);
        }
    }
}
