//! The planes of an image during estimation, in two colours of a checkerboard: a sweep changes one
//! colour and reads the other, so that its result does not depend on the order of pixels.

use super::cost::Selection;
use super::maps::PlaneMap;
use crate::ncc::OUTSIDE;
use crate::plane::Plane;

/// Plane and cost of a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    pub(super) plane: Plane,
    pub(super) cost: f32,
    /// The source images that the cost is over.
    pub(super) selection: Option<Selection>,
}

impl Cell {
    /// A plane whose cost is not known.
    pub(super) fn new(plane: Plane) -> Self {
        Self { plane, cost: OUTSIDE, selection: None }
    }
}

/// Colour of a pixel.
pub(super) fn color(x: usize, y: usize) -> usize {
    (x + y) % 2
}

/// Planes of all pixels. The pixels of a row with one colour are contiguous.
pub(super) struct Field {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Cells of a colour in a row.
    pub(super) stride: usize,
    pub(super) colors: [Vec<Cell>; 2],
}

impl Field {
    pub(super) fn new(width: usize, height: usize, cell: impl Fn(usize, usize) -> Cell) -> Self {
        let stride = width.div_ceil(2);
        let cells = |color: usize| {
            let at = |index: usize| {
                let (y, half) = (index / stride, index % stride);
                let x = 2 * half + (color + y) % 2;
                if x < width { cell(x, y) } else { Cell::new(Plane::default()) }
            };
            (0..stride * height).map(at).collect()
        };
        Self { width, height, stride, colors: [cells(0), cells(1)] }
    }

    /// The cell of a pixel.
    pub(super) fn cell(&self, x: usize, y: usize) -> &Cell {
        &self.colors[color(x, y)][y * self.stride + x / 2]
    }

    pub(super) fn into_map(self) -> PlaneMap {
        let Self { width, height, .. } = self;
        let at = |index: usize| {
            let Cell { plane, cost, .. } = self.cell(index % width, index / width);
            [plane.inverse_depth, plane.slope[0], plane.slope[1], *cost]
        };
        let planes = (0..width * height).map(at).collect();
        PlaneMap { width, height, planes }
    }
}
