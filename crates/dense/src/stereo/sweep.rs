//! One sweep over the pixels of one colour: planes of neighbours are tried (the asymmetric
//! checkerboard propagation of Xu & Tao 2019), then changes of the plane.

use rayon::prelude::*;

use super::cost::{Costs, MAX_SELECTED_COST, PixelCosts};
use super::field::{Cell, Field, color};
use super::rng::PixelRng;
use crate::Grey;
use crate::ncc::{Isa, Ncc, OUTSIDE, PatchTable, RADIUS, Task, dispatch};
use crate::plane::Plane;

/// Offsets of the neighbours of the other colour in four near and four far regions; of each
/// region, the plane of the lowest cost is tried.
const NEAR: [[[isize; 2]; 7]; 4] = [
    [[0, -1], [-1, -2], [1, -2], [-2, -3], [2, -3], [-3, -4], [3, -4]],
    [[0, 1], [-1, 2], [1, 2], [-2, 3], [2, 3], [-3, 4], [3, 4]],
    [[-1, 0], [-2, -1], [-2, 1], [-3, -2], [-3, 2], [-4, -3], [-4, 3]],
    [[1, 0], [2, -1], [2, 1], [3, -2], [3, 2], [4, -3], [4, 3]],
];
const FAR_DIRECTIONS: [[isize; 2]; 4] = [[0, -1], [0, 1], [-1, 0], [1, 0]];
const FAR_DISTANCES: [isize; 11] = [3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23];

/// Planes whose inverse depths at the pixel differ by less than this share of a pixel of parallax,
/// and whose slopes differ by less over the radius of a patch, have the same cost: positions are
/// rounded to 1/64 pixel.
const SAME_PX: f32 = 1.0 / 64.0;

/// Options of a sweep.
#[derive(Clone, Copy, Debug)]
pub(super) struct SweepOptions {
    /// Seed of the random numbers.
    pub(super) random: u64,
    /// Whether costs are known, from a sweep on the same level.
    pub(super) has_costs: bool,
    /// Whether the source images of each pixel are selected anew: those that see its first plane.
    pub(super) selects: bool,
    /// Whether planes of far neighbours are tried, too.
    pub(super) far: bool,
    /// Largest random change of the parallax, in pixels.
    pub(super) change_px: f32,
    /// Largest random change of the components of the unit normal.
    pub(super) change_normal: f32,
    /// Whether a plane of random depth and normal is tried.
    pub(super) random_plane: bool,
}

/// Sweeps over both colours.
pub(super) fn sweep(field: &mut Field, grey: &Grey, costs: &Costs, options: &SweepOptions) {
    let isa = Isa::best();
    for color in 0..2 {
        sweep_color(field, color, grey, costs, options, isa);
    }
}

fn sweep_color(
    field: &mut Field,
    color: usize,
    grey: &Grey,
    costs: &Costs,
    options: &SweepOptions,
    isa: Isa,
) {
    let table = PatchTable::new(field.width);
    let Field { width, height, stride, colors: [first, second] } = field;
    let (own, other) = if color == 0 { (first, &*second) } else { (second, &*first) };
    let (width, height, stride) = (*width, *height, *stride);
    own.par_chunks_mut(stride).enumerate().for_each(|(y, cells)| {
        let (table, context) = (&table, Context { width, height, stride, grey, costs, options });
        dispatch(isa, Row { context, table, color, y, cells, other });
    });
}

struct Context<'a> {
    width: usize,
    height: usize,
    stride: usize,
    grey: &'a Grey,
    costs: &'a Costs,
    options: &'a SweepOptions,
}

/// A row of pixels of one colour.
struct Row<'a> {
    context: Context<'a>,
    table: &'a PatchTable,
    color: usize,
    y: usize,
    cells: &'a mut [Cell],
    other: &'a [Cell],
}

impl Task for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run<N: Ncc>(self) {
        let Self { context, table, color, y, cells, other } = self;
        for (half, cell) in cells.iter_mut().enumerate() {
            let x = 2 * half + (color + y) % 2;
            if x < context.width {
                context.update::<N>(table, x, y, cell, other);
            }
        }
    }
}

impl Context<'_> {
    /// The cell of a pixel of the other colour.
    #[inline(always)]
    fn other<'c>(
        &self,
        x: usize,
        y: usize,
        offset: [isize; 2],
        other: &'c [Cell],
    ) -> Option<&'c Cell> {
        let x = x.checked_add_signed(offset[0]).filter(|x| *x < self.width)?;
        let y = y.checked_add_signed(offset[1]).filter(|y| *y < self.height)?;
        debug_assert_eq!(color(x, y), color(x + 2, y));
        other.get(y * self.stride + x / 2)
    }

    /// The neighbour of the lowest cost among `offsets`, as its plane at the pixel.
    #[inline(always)]
    fn best_of(
        &self,
        x: usize,
        y: usize,
        offsets: impl Iterator<Item = [isize; 2]>,
        other: &[Cell],
    ) -> Option<Plane> {
        let mut best: Option<(f32, &Cell, [isize; 2])> = None;
        for offset in offsets {
            if let Some(cell) = self.other(x, y, offset, other)
                && best.is_none_or(|(cost, ..)| cell.cost < cost)
            {
                best = Some((cell.cost, cell, offset));
            }
        }
        let (_, cell, [dx, dy]) = best?;
        Some(cell.plane.moved(-dx as f32, -dy as f32))
    }

    #[inline(always)]
    fn update<N: Ncc>(
        &self,
        table: &PatchTable,
        x: usize,
        y: usize,
        cell: &mut Cell,
        other: &[Cell],
    ) {
        let Self { costs, options, .. } = *self;
        // A flat patch keeps the plane and the cost of the coarser level, whose patch is larger.
        let Some(patch) = table.patch(self.grey, x, y) else { return };
        let (u, v) = (x as f32, y as f32);
        let pixel = costs.pixel(&patch, u, v);
        if options.selects {
            (cell.cost, cell.selection) = pixel.select::<N>(&cell.plane);
        } else if !options.has_costs {
            cell.cost = pixel.cost::<N>(&cell.plane, cell.selection, OUTSIDE);
        }
        let Some(per_px) = pixel.inverse_depth_per_pixel(cell.plane.inverse_depth) else { return };
        for region in NEAR {
            let plane = self.best_of(x, y, region.into_iter(), other);
            offer::<N>(&pixel, cell, plane, per_px);
        }
        if options.far {
            for [dx, dy] in FAR_DIRECTIONS {
                let offsets = FAR_DISTANCES.iter().map(|distance| [dx * distance, dy * distance]);
                let plane = self.best_of(x, y, offsets, other);
                offer::<N>(&pixel, cell, plane, per_px);
            }
        }
        // Changes of a plane of high cost seldom find one of low cost, and take most time where no
        // image is selected. Where random planes are tried, one of them may be right.
        if cell.cost >= MAX_SELECTED_COST && !options.random_plane {
            return;
        }
        let mut rng = PixelRng::new(options.random, y * self.width + x);
        let rays = &costs.rays;
        let [du, dv, dw] = rng.three();
        let change = |plane: &Plane, depth: f32, slope: [f32; 2]| {
            let unit = rays.unit_normal(u, v, plane);
            let [p, q] = slope.map(|slope| options.change_normal * slope);
            let normal = [unit[0] + p, unit[1] + q, unit[2]];
            let inverse_depth = plane.inverse_depth + depth * options.change_px * per_px;
            rays.plane(u, v, inverse_depth, &normal)
        };
        let moved = Plane {
            inverse_depth: cell.plane.inverse_depth + dw * options.change_px * per_px,
            ..cell.plane
        };
        offer::<N>(&pixel, cell, Some(moved), per_px);
        offer::<N>(&pixel, cell, change(&cell.plane, 0.0, [du, dv]), per_px);
        let [du, dv, dw] = rng.three();
        offer::<N>(&pixel, cell, change(&cell.plane, 0.5 * dw, [0.5 * du, 0.5 * dv]), per_px);
        if options.random_plane {
            let [du, dv, dw] = rng.three();
            let range = &costs.range;
            let inverse_depth = range.min + (range.max - range.min) * 0.5 * (dw + 1.0);
            let frontal = rays.unit_normal(u, v, &Plane::frontal(inverse_depth));
            let normal = [frontal[0] + du, frontal[1] + dv, frontal[2]];
            offer::<N>(&pixel, cell, rays.plane(u, v, inverse_depth, &normal), per_px);
        }
    }
}

/// Takes over a plane if its cost is lower.
#[inline(always)]
fn offer<N: Ncc>(pixel: &PixelCosts, cell: &mut Cell, plane: Option<Plane>, per_px: f32) {
    let Some(plane) = plane else { return };
    let same = SAME_PX * per_px;
    let is_same = |a: f32, b: f32, factor: f32| (a - b).abs() * factor < same;
    if is_same(plane.inverse_depth, cell.plane.inverse_depth, 1.0)
        && is_same(plane.slope[0], cell.plane.slope[0], RADIUS as f32)
        && is_same(plane.slope[1], cell.plane.slope[1], RADIUS as f32)
    {
        return;
    }
    let cost = pixel.cost::<N>(&plane, cell.selection, cell.cost);
    if cost < cell.cost {
        (cell.plane, cell.cost) = (plane, cost);
    }
}
