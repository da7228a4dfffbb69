//! The places of an undistorted image's pixels in its source: exact on a grid, and cubic between.

use rayon::prelude::*;
use tiepoint_geometry::nalgebra::Vector2;

/// Pixels between nodes of the grid.
pub(super) const CELL: usize = 16;
/// Bits of a fraction of a pixel in a [`Walk`]: the third difference of a cubic is summed up 16³ / 6
/// times.
pub(super) const FRACTION_BITS: u32 = 40;
/// Largest error of a cubic at the centre of its cell, in pixels; there the error is largest. Next
/// to an edge of 255 grey levels it changes a quarter of a level.
const MAX_ERROR_PX: f64 = 1e-3;
/// Places farther away are not walked to: they would not fit their integers.
const MAX_PLACE_PX: f64 = 1e6;

type Nodes = [[Vector2<f64>; 4]; 4];

/// Source places of all pixels of the undistorted image.
pub(super) struct SourceMap {
    /// Nodes of a row of the grid.
    columns: usize,
    /// The place of the node (i, j), which is the corner (16 (i − 1), 16 (j − 1)) of the pixels.
    nodes: Vec<Option<Vector2<f64>>>,
    /// Whether the cubic of a cell is exact enough.
    is_smooth: Vec<bool>,
}

impl SourceMap {
    /// `source` is the place in the source of a place in the image.
    pub(super) fn new(
        width: u32,
        height: u32,
        source: impl Fn(&Vector2<f64>) -> Option<Vector2<f64>> + Sync,
    ) -> Self {
        let cells = |size: u32| (size as usize).div_ceil(CELL);
        let (wide, high) = (cells(width), cells(height));
        let columns = wide + 3;
        let place = |x: f64, y: f64| source(&(Vector2::new(x, y) * CELL as f64));
        let node = |index: usize| {
            place((index % columns) as f64 - 1.0, (index / columns) as f64 - 1.0)
                .filter(|place| place.amax() < MAX_PLACE_PX)
        };
        let nodes = (0..columns * (high + 3)).into_par_iter().map(node).collect();
        let mut map = Self { columns, nodes, is_smooth: Vec::new() };
        let is_smooth = |index: usize| {
            let (column, row) = (index % wide, index / wide);
            let exact = place(column as f64 + 0.5, row as f64 + 0.5);
            let (Some(nodes), Some(exact)) = (map.nodes_of(column, row), exact) else {
                return false;
            };
            let middle = weights(0.5);
            let cubic = mixed(&middle, &nodes.map(|row| mixed(&middle, &row)));
            (cubic - exact).amax() < MAX_ERROR_PX
        };
        map.is_smooth = (0..wide * high).into_par_iter().map(is_smooth).collect();
        map
    }

    /// The nodes around a cell, by rows.
    fn nodes_of(&self, column: usize, row: usize) -> Option<Nodes> {
        let mut nodes = Nodes::default();
        for (j, nodes) in nodes.iter_mut().enumerate() {
            for (i, node) in nodes.iter_mut().enumerate() {
                *node = self.nodes[(row + j) * self.columns + column + i]?;
            }
        }
        Some(nodes)
    }

    /// The walk along the pixels of a row in the `cell`-th cell of the row; `None` where the places
    /// are to be computed exactly.
    pub(super) fn walk(&self, cell: usize, row: usize) -> Option<Walk> {
        let wide = self.columns - 3;
        let of_cells = row / CELL;
        if !self.is_smooth[of_cells * wide + cell] {
            return None;
        }
        let nodes = self.nodes_of(cell, of_cells)?;
        let down = weights(((row % CELL) as f64 + 0.5) / CELL as f64);
        let line: [Vector2<f64>; 4] = std::array::from_fn(|i| mixed(&down, &nodes.map(|r| r[i])));
        // The first four pixels determine the cubic.
        let at = |pixel: usize| mixed(&weights((pixel as f64 + 0.5) / CELL as f64), &line);
        let [a, b, c, d] = [at(0), at(1), at(2), at(3)];
        let fixed = |value: f64| (value * (1u64 << FRACTION_BITS) as f64) as i64;
        Some(Walk([0, 1].map(|axis| {
            let (a, b, c, d) = (a[axis], b[axis], c[axis], d[axis]);
            [a, b - a, c - 2.0 * b + a, d - 3.0 * c + 3.0 * b - a].map(fixed)
        })))
    }
}

/// A place that goes from pixel to pixel of a row: x and y with their forward differences, in units
/// of 2^−[`FRACTION_BITS`] pixels.
pub(super) struct Walk([[i64; 4]; 2]);

impl Walk {
    /// The place, in units of 2^−[`FRACTION_BITS`] pixels. Goes on to the next pixel.
    #[inline]
    pub(super) fn step(&mut self) -> [i64; 2] {
        let place = [self.0[0][0], self.0[1][0]];
        for [value, first, second, third] in &mut self.0 {
            *value += *first;
            *first += *second;
            *second += *third;
        }
        place
    }
}

/// Weights of the cubic through values at −1, 0, 1 and 2.
fn weights(t: f64) -> [f64; 4] {
    let (a, b, c) = (t + 1.0, t - 1.0, t - 2.0);
    [-t * b * c / 6.0, a * b * c / 2.0, -a * t * c / 2.0, a * t * b / 6.0]
}

fn mixed(weights: &[f64; 4], values: &[Vector2<f64>; 4]) -> Vector2<f64> {
    weights.iter().zip(values).map(|(weight, value)| value * *weight).sum()
}
