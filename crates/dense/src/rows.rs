//! Times and poses of the rows of a rolling-shutter photo, for the pixels of its undistorted image.

use std::sync::Arc;

use tiepoint_geometry::nalgebra::Vector2;
use tiepoint_geometry::{Rigid3, RowPoses};

use crate::undistort::Undistortion;

/// Pixels between nodes of the grid. For a lens with a distortion of −0.3 r² and a focal length of
/// 500 pixels, the bilinear row is off by a tenth of a row.
const CELL: u32 = 16;

/// The times of the pixels of an undistorted image: on a grid, and bilinear between.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RowTimes {
    /// Nodes of a row of the grid, which begins at the corner of the image.
    columns: usize,
    /// Distance of the nodes, in pixels.
    cell_px: f32,
    /// The row of the photo over its height, minus a half: from −½ to ½ during the readout.
    nodes: Arc<[f32]>,
}

/// A time, in readouts from the middle row, and its derivatives by x and y, in pixels.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RowTime {
    pub(crate) time: f32,
    pub(crate) slope: [f32; 2],
}

impl RowTimes {
    fn new(undistortion: &Undistortion) -> Self {
        let (from, to) = (undistortion.from(), undistortion.to());
        let [columns, rows] = [to.width, to.height].map(|size| size.div_ceil(CELL) + 1);
        let node = |index: u32| {
            let place = Vector2::new(f64::from(index % columns), f64::from(index / columns));
            let place = place * f64::from(CELL);
            // The last nodes lie beyond the photo; a lens may have no places there, or far ones.
            let row = match undistortion.source(&place) {
                Some(source) => source.y / f64::from(from.height),
                None => place.y / f64::from(to.height),
            };
            (row.clamp(-1.0, 2.0) - 0.5) as f32
        };
        let nodes = (0..columns * rows).map(node).collect();
        Self { columns: columns as usize, cell_px: CELL as f32, nodes }
    }

    /// The time of a pixel index that need not be whole nor in the image.
    #[inline(always)]
    pub(crate) fn at(&self, x: f32, y: f32) -> RowTime {
        let per_px = 1.0 / self.cell_px;
        let (x, y) = ((x + 0.5) * per_px, (y + 0.5) * per_px);
        let rows = self.nodes.len() / self.columns;
        let (column, row) = ((x as usize).min(self.columns - 2), (y as usize).min(rows - 2));
        let (u, v) = (x - column as f32, y - row as f32);
        let at = |down: usize| {
            let first = (row + down) * self.columns + column;
            [self.nodes[first], self.nodes[first + 1]]
        };
        let ([a, b], [c, d]) = (at(0), at(1));
        let (top, bottom) = (a + (b - a) * u, c + (d - c) * u);
        let along = (b - a) * (1.0 - v) + (d - c) * v;
        let slope = [along * per_px, (bottom - top) * per_px];
        RowTime { time: top + (bottom - top) * v, slope }
    }

    /// Those of the image at half resolution.
    fn halved(&self) -> Self {
        Self { cell_px: 0.5 * self.cell_px, ..self.clone() }
    }
}

/// The poses of the pixels of an undistorted image whose photo was exposed row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct PixelPoses {
    rows: RowPoses,
    pub(crate) times: RowTimes,
}

impl PixelPoses {
    /// `rows`: of the photo. `undistortion`: from the photo to the undistorted image.
    pub fn new(rows: RowPoses, undistortion: &Undistortion) -> Self {
        Self { rows, times: RowTimes::new(undistortion) }
    }

    /// The pose at a time, in readouts from the middle row, whose pose is `middle`.
    pub(crate) fn at_time(&self, middle: &Rigid3, time: f64) -> Rigid3 {
        self.rows.cam_from_world(middle, (time + 0.5) * self.rows.height_px)
    }

    /// Those of the image at half resolution.
    pub(crate) fn halved(&self) -> Self {
        Self { rows: self.rows, times: self.times.halved() }
    }
}
