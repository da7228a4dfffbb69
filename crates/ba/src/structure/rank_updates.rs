//! Groups the factors of a batch that have the same shape and column blocks, for one rank-k update
//! of C.

use super::shape::Shape;
use super::task::{Batch, LandmarkBlock, RankUpdate, Task, pair};

/// Collects the factors of a batch.
#[derive(Default)]
pub(super) struct RankUpdateBuilder {
    /// Hash of shape and blocks, then the factor's number.
    keys: Vec<u64>,
    factors: Vec<PendingFactor>,
    /// Vector offsets of their segments and tile offsets of pairs of segments, as in
    /// [`RankUpdate`].
    targets: Vec<u32>,
}

struct PendingFactor {
    shape: u16,
    /// Index of its first target in [`RankUpdateBuilder::targets`].
    first_target: usize,
    /// Offset of its rows in the batch.
    row: u32,
}

impl PendingFactor {
    /// Its part of the builder's `targets`: one entry for each segment, then one for each pair of
    /// segments.
    fn targets<'a>(&self, shapes: &[Shape], targets: &'a [u32]) -> &'a [u32] {
        let segments = shapes[self.shape as usize].segments.len();
        &targets[self.first_target..][..segments + segments * (segments + 1) / 2]
    }
}

impl RankUpdateBuilder {
    /// Adds the factors of the task's last landmark block. `first` are the indices of its first
    /// factor and of that factor's first block index; `row` is the offset of its rows in the batch.
    pub(super) fn add(
        &mut self,
        task: &Task,
        shapes: &[Shape],
        landmark: &LandmarkBlock,
        first: [usize; 2],
        row: usize,
    ) {
        let [first, first_index] = first;
        let pattern = task.patterns.of(landmark);
        let (mut indices, mut row) = (&task.factors.block_indices[first_index..], row);
        for &number in &task.factors.shape_of[first..] {
            let shape = &shapes[number as usize];
            let (these, rest) = indices.split_at(shape.segments.len());
            indices = rest;
            let begin = self.targets.len();
            let at = |&index: &u16| {
                task.patterns.blocks[pattern.blocks.start + index as usize].vector_offset as u32
            };
            self.targets.extend(these.iter().map(at));
            let key = self.targets[begin..].iter().fold(u32::from(number), hash);
            for (s, &l) in these.iter().enumerate() {
                let tile = |&m: &u16| {
                    let (lo, hi) = (l.min(m) as usize, l.max(m) as usize);
                    task.patterns.pair_tiles[pattern.pairs + pair(pattern.blocks.len(), lo, hi)]
                };
                self.targets.extend(these[..=s].iter().map(tile));
            }
            self.keys.push(u64::from(key) << 32 | self.factors.len() as u64);
            self.factors.push(PendingFactor {
                shape: number,
                first_target: begin,
                row: row as u32,
            });
            row += shape.rows * shape.stride;
        }
    }

    /// Adds the batch and its rank-k updates to the task.
    pub(super) fn close(&mut self, task: &mut Task, shapes: &[Shape], mut batch: Batch) {
        let begin = task.rank_updates.list.len();
        self.keys.sort_unstable();
        let mut last: Option<&PendingFactor> = None;
        for &key in &self.keys {
            let pending = &self.factors[key as u32 as usize];
            let targets = pending.targets(shapes, &self.targets);
            let same = last.is_some_and(|last| {
                last.shape == pending.shape && last.targets(shapes, &self.targets) == targets
            });
            if !same {
                let rows = task.rank_updates.rows.len();
                let rank_update = RankUpdate {
                    shape: pending.shape,
                    targets: task.rank_updates.targets.len(),
                    rows: rows..rows,
                };
                task.rank_updates.list.push(rank_update);
                task.rank_updates.targets.extend_from_slice(targets);
            }
            last = Some(pending);
            let shape = &shapes[pending.shape as usize];
            task.rank_updates
                .rows
                .extend((0..shape.rows).map(|row| pending.row + (row * shape.stride) as u32));
            if let Some(rank_update) = task.rank_updates.list.last_mut() {
                rank_update.rows.end = task.rank_updates.rows.len();
            }
        }
        batch.rank_updates = begin..task.rank_updates.list.len();
        task.batches.push(batch);
        self.keys.clear();
        self.factors.clear();
        self.targets.clear();
    }
}

/// Hash of a number, given that of the numbers before.
fn hash(sum: u32, number: &u32) -> u32 {
    (sum ^ number).wrapping_mul(0x9e37_79b1).rotate_left(13)
}
