//! The places of an undistorted image's pixels in its source: exact on a grid, and cubic between.

use rayon::prelude::*;
use tiepoint_geometry::nalgebra::Vector2;

/// Pixels between nodes of the grid.
pub(super) const CELL: usize = 16;
/// Bits of a fraction of a pixel in a [`Walk`]: a third difference is summed up 16³ / 6 times.
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

    /// The walk through the pixels of a cell: the `column`-th one of the `row`-th row of cells.
    /// `None` where the places are to be computed exactly.
    pub(super) fn walk(&self, column: usize, row: usize) -> Option<Walk> {
        if !self.is_smooth[row * (self.columns - 3) + column] {
            return None;
        }
        let nodes = self.nodes_of(column, row)?;
        // The first four pixels of the first four rows determine the cubic.
        let steps = [0.5, 1.5, 2.5, 3.5].map(|pixel| weights(pixel / CELL as f64));
        let rows = steps.map(|down| {
            let line = std::array::from_fn(|i| mixed(&down, &nodes.map(|row| row[i])));
            differences(steps.map(|along| mixed(&along, &line)))
        });
        let fixed = |value: f64| (value * (1u64 << FRACTION_BITS) as f64) as i64;
        Some(Walk([0, 1].map(|axis| {
            [0, 1, 2, 3]
                .map(|k| differences(rows.map(|row| row[k])).map(|value| fixed(value[axis])))
        })))
    }
}

/// A value at 0 and its forward differences, from the values at 0, 1, 2 and 3.
fn differences([a, b, c, d]: [Vector2<f64>; 4]) -> [Vector2<f64>; 4] {
    [a, b - a, c - b * 2.0 + a, d - c * 3.0 + b * 3.0 - a]
}

/// A place that goes from row to row of a cell: of x and y the value and the forward differences
/// along the row, each with its forward differences from row to row, in units of
/// 2^−[`FRACTION_BITS`] pixels.
pub(super) struct Walk([[[i64; 4]; 4]; 2]);

impl Walk {
    /// The walk along the row. Goes on to the next row.
    #[inline]
    pub(super) fn next_row(&mut self) -> RowWalk {
        let mut row = [[0; 4]; 2];
        for (row, axis) in row.iter_mut().zip(&mut self.0) {
            for (now, cubic) in row.iter_mut().zip(axis) {
                *now = step(cubic);
            }
        }
        RowWalk(row)
    }
}

/// A place that goes from pixel to pixel of a row: x and y with their forward differences.
pub(super) struct RowWalk(pub(super) [[i64; 4]; 2]);

impl RowWalk {
    /// The places of the pixels, in units of 2^−[`FRACTION_BITS`] pixels.
    #[inline]
    pub(super) fn places(mut self) -> [[i64; 2]; CELL] {
        let mut places = [[0; 2]; CELL];
        for place in &mut places {
            *place = [step(&mut self.0[0]), step(&mut self.0[1])];
        }
        places
    }
}

/// The value of a cubic, which goes on by one.
#[inline]
fn step([value, first, second, third]: &mut [i64; 4]) -> i64 {
    let now = *value;
    *value += *first;
    *first += *second;
    *second += *third;
    now
}

/// Weights of the cubic through values at −1, 0, 1 and 2.
fn weights(t: f64) -> [f64; 4] {
    let (a, b, c) = (t + 1.0, t - 1.0, t - 2.0);
    [-t * b * c / 6.0, a * b * c / 2.0, -a * t * c / 2.0, a * t * b / 6.0]
}

fn mixed(weights: &[f64; 4], values: &[Vector2<f64>; 4]) -> Vector2<f64> {
    weights.iter().zip(values).map(|(weight, value)| value * *weight).sum()
}
