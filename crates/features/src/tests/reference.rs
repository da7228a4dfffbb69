//! Reference implementation of SIFT: direct convolution of whole images and loops over all samples,
//! in double precision.

use crate::GrayView;
use crate::scale_space::{kernel_from_image, kernels_between_levels};
use std::f64::consts::{SQRT_2, TAU};

/// A level in double precision.
#[derive(Clone)]
pub(crate) struct Plane {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) data: Vec<f64>,
}

impl Plane {
    pub(crate) fn at(&self, x: isize, y: isize) -> f64 {
        let (x, y) = (x.clamp(0, self.width as isize - 1), y.clamp(0, self.height as isize - 1));
        self.data[y as usize * self.width + x as usize]
    }

    pub(crate) fn from_fn(width: usize, height: usize, f: impl Fn(isize, isize) -> f64) -> Plane {
        let data =
            (0..width * height).map(|i| f((i % width) as isize, (i / width) as isize)).collect();
        Plane { width, height, data }
    }

    /// Direct two-dimensional convolution.
    pub(crate) fn blurred(&self, kernel: &[f32]) -> Plane {
        let radius = kernel.len() as isize - 1;
        Plane::from_fn(self.width, self.height, |x, y| {
            let mut sum = 0.0;
            for dy in -radius..=radius {
                for dx in -radius..=radius {
                    let weight =
                        f64::from(kernel[dx.unsigned_abs()]) * f64::from(kernel[dy.unsigned_abs()]);
                    sum += weight * self.at(x + dx, y + dy);
                }
            }
            sum
        })
    }
}

/// The levels of an octave.
pub(crate) fn reference_levels(source: &Plane, octave: i32, levels: usize) -> Vec<Plane> {
    let mut planes = vec![source.blurred(&kernel_from_image(octave, -1))];
    for kernel in kernels_between_levels(levels) {
        planes.push(planes[planes.len() - 1].blurred(&kernel));
    }
    planes
}

/// Candidate extrema (level, x, y) of the differences of levels, before refinement.
pub(crate) fn reference_extrema(planes: &[Plane], min_value: f64) -> Vec<(usize, usize, usize)> {
    let at = |i: usize, x: isize, y: isize| planes[i + 1].at(x, y) - planes[i].at(x, y);
    let mut found = Vec::new();
    for i in 1..planes.len() - 2 {
        for y in 1..planes[0].height as isize - 1 {
            for x in 1..planes[0].width as isize - 1 {
                let value = at(i, x, y);
                let mut others = Vec::new();
                for j in i - 1..=i + 1 {
                    for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
                        if (j, dx, dy) != (i, 0, 0) {
                            others.push(at(j, x + dx, y + dy));
                        }
                    }
                }
                if value.abs() >= min_value
                    && (others.iter().all(|&o| value > o) || others.iter().all(|&o| value < o))
                {
                    found.push((i, x as usize, y as usize));
                }
            }
        }
    }
    found
}

/// The image, or the image at double resolution as in VLFeat.
pub(crate) fn reference_source(view: &GrayView<'_>, octave: i32) -> Plane {
    let image = Plane::from_fn(view.width, view.height, |x, y| {
        f64::from(view.row(y as usize)[x as usize]) / 255.0
    });
    if octave >= 0 {
        return image;
    }
    Plane::from_fn(2 * view.width, 2 * view.height, |x, y| {
        let (x0, y0) = (x / 2, y / 2);
        let (x1, y1) = (x0 + x % 2, y0 + y % 2);
        0.25 * (image.at(x0, y0) + image.at(x1, y0) + image.at(x0, y1) + image.at(x1, y1))
    })
}

/// Refines a candidate as described in module `extrema`, with Cramer's rule. Returns sample,
/// position and value, or `None` if the extremum does not pass the thresholds.
pub(crate) fn reference_refined(
    planes: &[Plane],
    (i, x, y): (usize, usize, usize),
    peak: f64,
    edge: f64,
) -> Option<[f64; 5]> {
    let (width, height) = (planes[0].width as isize, planes[0].height as isize);
    let (mut x, mut y) = (x as isize, y as isize);
    let difference = |j: isize, x: isize, y: isize| {
        planes[(i as isize + j + 1) as usize].at(x, y) - planes[(i as isize + j) as usize].at(x, y)
    };
    let mut step = 1;
    loop {
        let at = |dx: isize, dy: isize, j: isize| difference(j, x + dx, y + dy);
        let first = |d: [isize; 3]| (at(d[0], d[1], d[2]) - at(-d[0], -d[1], -d[2])) / 2.0;
        let second =
            |d: [isize; 3]| at(d[0], d[1], d[2]) + at(-d[0], -d[1], -d[2]) - 2.0 * at(0, 0, 0);
        let axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
        let mixed = |a: usize, b: usize| {
            let plus = [0, 1, 2].map(|k| axes[a][k] + axes[b][k]);
            let minus = [0, 1, 2].map(|k| axes[a][k] - axes[b][k]);
            (second(plus) - second(minus)) / 4.0
        };
        let g = axes.map(first);
        let h = [0, 1, 2]
            .map(|a| [0, 1, 2].map(|b| if a == b { second(axes[a]) } else { mixed(a, b) }));
        let det = |m: [[f64; 3]; 3]| {
            m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
                - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
                + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
        };
        let offset = [0, 1, 2].map(|k| {
            let mut m = h;
            (0..3).for_each(|r| m[r][k] = -g[r]);
            det(m) / det(h)
        });
        let next_sample = |v: isize, d: f64, size: isize| match d {
            d if d > 0.6 && v < size - 2 => v + 1,
            d if d < -0.6 && v > 1 => v - 1,
            _ => v,
        };
        let next = (next_sample(x, offset[0], width), next_sample(y, offset[1], height));
        if next != (x, y) && step < 5 {
            (x, y) = next;
            step += 1;
            continue;
        }
        let value = at(0, 0, 0) + (0..3).map(|k| g[k] * offset[k]).sum::<f64>() / 2.0;
        let score = (h[0][0] + h[1][1]).powi(2) / (h[0][0] * h[1][1] - h[0][1] * h[0][1]);
        let position = (x as f64 + offset[0], y as f64 + offset[1]);
        let inside = (0.0..=(width - 1) as f64).contains(&position.0)
            && (0.0..=(height - 1) as f64).contains(&position.1);
        let good = value.abs() > peak
            && (0.0..(edge + 1.0).powi(2) / edge).contains(&score)
            && offset.iter().all(|o| o.abs() < 1.5)
            && inside;
        return good.then_some([x as f64, y as f64, position.0, position.1, value.abs()]);
    }
}

/// Gradient of a level: magnitude and direction from 0 to 2π.
fn gradient(level: &Plane, x: usize, y: usize) -> (f64, f64) {
    let (x, y) = (x as isize, y as isize);
    let gx = (level.at(x + 1, y) - level.at(x - 1, y)) / 2.0;
    let gy = (level.at(x, y + 1) - level.at(x, y - 1)) / 2.0;
    (gx.hypot(gy), gy.atan2(gx).rem_euclid(TAU))
}

/// Dominant orientations and the heights of their maxima, in descending order of height.
pub(crate) fn reference_directions(
    level: &Plane,
    (x, y): (f64, f64),
    sigma: f64,
) -> Vec<(f64, f64)> {
    let sigma = 1.5 * sigma;
    let radius = (3.0 * sigma).floor();
    let mut histogram = [0.0; 36];
    for iy in 1..level.height - 1 {
        for ix in 1..level.width - 1 {
            let (dx, dy) = (ix as f64 - x, iy as f64 - y);
            let inside =
                (ix as f64 - x.round()).abs() <= radius && (iy as f64 - y.round()).abs() <= radius;
            let r2 = dx * dx + dy * dy;
            if !inside || r2 >= radius * radius + 0.6 {
                continue;
            }
            let (magnitude, angle) = gradient(level, ix, iy);
            let weight = magnitude * (-r2 / (2.0 * sigma * sigma)).exp();
            let bin = angle / TAU * 36.0 - 0.5;
            let share = bin - bin.floor();
            let bin = bin.floor().rem_euclid(36.0) as usize;
            histogram[bin] += weight * (1.0 - share);
            histogram[(bin + 1) % 36] += weight * share;
        }
    }
    for _ in 0..6 {
        let h = histogram;
        histogram = std::array::from_fn(|i| (h[(i + 35) % 36] + h[i] + h[(i + 1) % 36]) / 3.0);
    }
    let highest = histogram.iter().cloned().fold(0.0, f64::max);
    let mut found = Vec::new();
    for i in 0..36 {
        let (a, b, c) = (histogram[(i + 35) % 36], histogram[i], histogram[(i + 1) % 36]);
        if b > 0.8 * highest && b > a && b > c {
            found.push(((i as f64 + 0.5 - 0.5 * (c - a) / (c + a - 2.0 * b)) / 36.0 * TAU, b));
        }
    }
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    found
}

/// The descriptor of one window size, clamped, of unit length.
fn reference_unit_descriptor(
    level: &Plane,
    (x, y): (f64, f64),
    sigma: f64,
    angle: f64,
) -> [f64; 128] {
    let mut cells = [0.0; 128];
    let side = 3.0 * sigma;
    let reach = (SQRT_2 * side * 2.5 + 0.5).floor();
    for iy in 1..level.height - 1 {
        for ix in 1..level.width - 1 {
            let (dx, dy) = (ix as f64 - x, iy as f64 - y);
            if dx.abs() > reach || dy.abs() > reach {
                continue;
            }
            let u = (angle.cos() * dx + angle.sin() * dy) / side;
            let v = (-angle.sin() * dx + angle.cos() * dy) / side;
            let (magnitude, direction) = gradient(level, ix, iy);
            let t = (direction - angle).rem_euclid(TAU) / TAU * 8.0;
            let weight = magnitude * (-(u * u + v * v) / 8.0).exp();
            for (row, column) in (0..4).flat_map(|r| (0..4).map(move |c| (r, c))) {
                let near_u = 1.0 - (u - (column as f64 - 1.5)).abs();
                let near_v = 1.0 - (v - (row as f64 - 1.5)).abs();
                for bin in 0..8 {
                    let distance = (t - bin as f64).abs();
                    let near_t = 1.0 - distance.min(8.0 - distance);
                    // Directions are stored in the opposite rotation sense.
                    let at = (row * 4 + column) * 8 + (8 - bin) % 8;
                    cells[at] += weight * near_u.max(0.0) * near_v.max(0.0) * near_t.max(0.0);
                }
            }
        }
    }
    let norm = |c: &[f64; 128]| c.iter().map(|v| v * v).sum::<f64>().sqrt();
    let n = norm(&cells);
    let clamped = cells.map(|v| (v / n).min(0.2));
    let n = norm(&clamped);
    clamped.map(|v| v / n)
}

/// The RootSIFT descriptor, times 512, before rounding: the mean over the given window sizes.
pub(crate) fn reference_descriptor(
    level: &Plane,
    at: (f64, f64),
    sigma: f64,
    angle: f64,
    sizes: &[f64],
) -> [f64; 128] {
    let mut pooled = [0.0; 128];
    for size in sizes {
        for (sum, v) in
            pooled.iter_mut().zip(reference_unit_descriptor(level, at, size * sigma, angle))
        {
            *sum += v;
        }
    }
    let sum: f64 = pooled.iter().sum();
    pooled.map(|v| (v / sum).sqrt() * 512.0)
}
