//! The planes of an image during estimation, in two colours of a checkerboard: a sweep changes one
//! colour and reads the other, so that its result does not depend on the order of pixels.

use crate::plane::Plane;
use crate::stereo::maps::PlaneMap;

/// Plane and cost of a pixel.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cell {
    pub(super) plane: Plane,
    pub(super) cost: f32,
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
                if x < width { cell(x, y) } else { Cell::default() }
            };
            (0..stride * height).map(at).collect()
        };
        Self { width, height, stride, colors: [cells(0), cells(1)] }
    }

    pub(super) fn into_map(self) -> PlaneMap {
        let Self { width, height, stride, colors } = self;
        let at = |index: usize| {
            let (x, y) = (index % width, index / width);
            let Cell { plane, cost } = colors[color(x, y)][y * stride + x / 2];
            [plane.inverse_depth, plane.slope[0], plane.slope[1], cost]
        };
        let planes = (0..width * height).map(at).collect();
        PlaneMap { width, height, planes }
    }
}
