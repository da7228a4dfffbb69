//! How far the elimination has got.

use crate::structure::{Cell, Chunk};

/// Where in a chunk the elimination has got to.
#[derive(Clone, Copy, Default)]
pub(super) struct At {
    pub(super) factor: usize,
    pub(super) local: usize,
    /// In the rows of the batch.
    pub(super) row: usize,
}

impl At {
    /// Past cells of which nothing is subtracted.
    pub(super) fn skip(&mut self, chunk: &Chunk, cells: &[Cell]) {
        for &shape in &chunk.factors.shape_of[self.factor..cells[cells.len() - 1].end as usize] {
            let shape = &chunk.factors.shapes[shape as usize];
            self.local += shape.segments.len();
            self.row += shape.rows * shape.stride;
            self.factor += 1;
        }
    }
}
