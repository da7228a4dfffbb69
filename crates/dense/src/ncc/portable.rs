//! The kernel in portable Rust.

use super::constants::{LANES, MIDDLE, OUTSIDE, STEPS};
use super::kernel::{Ncc, Task, Warp, cost_of};
use super::patch::{DX, DY, Patch};
use super::source::Source;

#[derive(Clone, Copy)]
pub(super) struct Portable;

pub(super) fn enter<T: Task>(task: T) -> T::Output {
    task.run::<Portable>()
}

impl Ncc for Portable {
    #[inline(always)]
    fn cost(source: &Source, warp: &Warp, patch: &Patch) -> f32 {
        let [x_limit, y_limit] = source.limits();
        let (mut sums, mut squares, mut products) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for half in 0..2 {
            for lane in 0..LANES {
                let at = |axis: usize| {
                    let step = warp.dx[axis] * DX[half][lane] + warp.dy[axis] * DY[half][lane];
                    warp.centre[axis] + step
                };
                let z = at(2);
                let inverse = 1.0 / z;
                let (x, y) = (at(0) * inverse, at(1) * inverse);
                if !(z > 0.0 && x >= 0.0 && y >= 0.0 && x < x_limit && y < y_limit) {
                    return OUTSIDE;
                }
                let (x, y) = ((x * STEPS as f32) as i32, (y * STEPS as f32) as i32);
                let index = (y / STEPS) as usize * source.width + (x / STEPS) as usize;
                let (u, v) = (x % STEPS, y % STEPS);
                let [p00, p01, p10, p11] = source.words[index].to_le_bytes().map(i32::from);
                let top = p00 * (STEPS - u) + p01 * u;
                let bottom = p10 * (STEPS - u) + p11 * u;
                let level = ((top * (STEPS - v) + bottom * v) >> 8) as f32 - MIDDLE;
                let weighted = patch.weights[half][lane] * level;
                sums[lane] += weighted;
                squares[lane] += weighted * level;
                products[lane] += patch.centred[half][lane] * level;
            }
        }
        cost_of(reduced(sums), reduced(squares), reduced(products), patch)
    }
}

/// The sum of the lanes in the order of the vector code: halves are added until one is left.
fn reduced(mut lanes: [f32; LANES]) -> f32 {
    let mut width = LANES;
    while width > 1 {
        width /= 2;
        for lane in 0..width {
            lanes[lane] += lanes[lane + width];
        }
    }
    lanes[0]
}
