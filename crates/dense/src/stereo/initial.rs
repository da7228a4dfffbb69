//! First planes: those of the nearest points of the sparse model.

use super::field::{Cell, Field};
use super::rng::PixelRng;
use super::seeds::{InverseDepthRange, Seed};
use crate::plane::{Plane, Rays};

/// Largest slope of the first planes, as components of a normal beside a unit one along the ray:
/// 45° on average over the directions.
const SLOPE: f32 = 1.0;

/// Each pixel gets a plane of random normal through the inverse depth of the nearest seed. `scale`
/// is the size of a pixel of the level in pixels of the seeds.
pub(super) fn initial_field(
    width: usize,
    height: usize,
    rays: &Rays,
    seeds: &[Seed],
    scale: f32,
    range: &InverseDepthRange,
    random: u64,
) -> Field {
    let nearest = nearest_seeds(width, height, seeds, scale);
    Field::new(width, height, |x, y| {
        let mut rng = PixelRng::new(random, y * width + x);
        let inverse_depth =
            seeds[nearest[y * width + x] as usize].inverse_depth.clamp(range.min, range.max);
        let [u, v, _] = rng.three();
        let frontal = rays.unit_normal(x as f32, y as f32, &Plane::frontal(inverse_depth));
        let normal = [frontal[0] + SLOPE * u, frontal[1] + SLOPE * v, frontal[2]];
        let plane = rays
            .plane(x as f32, y as f32, inverse_depth, &normal)
            .filter(|plane| rays.sees(x as f32, y as f32, plane))
            .unwrap_or(Plane::frontal(inverse_depth));
        Cell::new(plane)
    })
}

/// Index of a near seed of each pixel, by two passes over the image (Danielsson 1980, 8SSED).
/// `seeds` is not empty.
fn nearest_seeds(width: usize, height: usize, seeds: &[Seed], scale: f32) -> Vec<u32> {
    const NONE: u32 = u32::MAX;
    let place = |seed: &Seed| seed.pixel.map(|value| value / scale - 0.5);
    let places: Vec<[f32; 2]> = seeds.iter().map(place).collect();
    let mut nearest = vec![NONE; width * height];
    let squared = |seed: u32, x: usize, y: usize| {
        let [u, v] = places[seed as usize];
        (u - x as f32).powi(2) + (v - y as f32).powi(2)
    };
    let offer = |nearest: &mut Vec<u32>, x: usize, y: usize, seed: u32| {
        let known = &mut nearest[y * width + x];
        if seed != NONE && (*known == NONE || squared(seed, x, y) < squared(*known, x, y)) {
            *known = seed;
        }
    };
    for (index, [u, v]) in places.iter().enumerate() {
        let clamp = |value: f32, size: usize| (value.round().max(0.0) as usize).min(size - 1);
        offer(&mut nearest, clamp(*u, width), clamp(*v, height), index as u32);
    }
    let pass = |nearest: &mut Vec<u32>, is_down: bool| {
        for row in 0..height {
            let y = if is_down { row } else { height - 1 - row };
            let before = if is_down { y.checked_sub(1) } else { (y + 1 < height).then_some(y + 1) };
            for x in 0..width {
                if let Some(before) = before {
                    for other in x.saturating_sub(1)..=(x + 1).min(width - 1) {
                        let seed = nearest[before * width + other];
                        offer(nearest, x, y, seed);
                    }
                }
                if x > 0 {
                    let seed = nearest[y * width + x - 1];
                    offer(nearest, x, y, seed);
                }
            }
            for x in (0..width - 1).rev() {
                let seed = nearest[y * width + x + 1];
                offer(nearest, x, y, seed);
            }
        }
    };
    pass(&mut nearest, true);
    pass(&mut nearest, false);
    nearest
}
