//! Position of the elimination in a task.

use crate::structure::{LandmarkBlock, Task};

/// Position of the elimination in a task: the next factor and its first block index.
#[derive(Clone, Copy, Default)]
pub(super) struct Cursor {
    pub(super) factor: usize,
    pub(super) block_index: usize,
    /// Offset of its rows in the batch.
    pub(super) row: usize,
}

impl Cursor {
    /// Skips landmark blocks from which nothing is subtracted.
    pub(super) fn skip(&mut self, task: &Task, landmarks: &[LandmarkBlock]) {
        for &shape in
            &task.factors.shape_of[self.factor..landmarks[landmarks.len() - 1].end as usize]
        {
            let shape = &task.factors.shapes[shape as usize];
            self.block_index += shape.segments.len();
            self.row += shape.rows * shape.stride;
            self.factor += 1;
        }
    }
}
