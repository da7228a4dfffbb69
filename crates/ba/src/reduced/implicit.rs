//! The reduced system without forming it: S x = C x − Yᵀ(Y x), landmark by landmark, from the
//! stashes. There is no fill-in, neither from factorisation nor from points that many cameras see:
//! memory is proportional to the observations (Agarwal, Snavely, Seitz, Szeliski 2010, "Bundle
//! adjustment in the large", section 3.3).
//!
//! C, the normal matrix of the kept variables alone, is formed from the tiles of blocks that share
//! a factor.

use crate::eliminate::LandmarkStash;
use crate::structure::{ColumnBlock, Structure, Task, for_each_task};
use crate::variable::MAX_ELIMINATED_DOF;

/// Results of the elimination.
#[derive(Clone, Copy)]
pub(crate) struct EliminatedSystem<'a> {
    pub(crate) structure: &'a Structure,
    /// Tiles and stashes of all tasks.
    pub(crate) memory: &'a [f64],
}

impl EliminatedSystem<'_> {
    /// y −= YᵀY x over the columns of the reduced system. The sums of the tasks are subtracted in
    /// order.
    pub(super) fn subtract_product(self, x: &[f64], y: &mut [f64]) {
        let blocks = &self.structure.blocks;
        let mut parts: Vec<Vec<f64>> = vec![Vec::new(); self.structure.tasks.len()];
        for_each_task(&self.structure.tasks, &mut parts, |task, part| {
            let mut kept = vec![0.0; task.vector_len];
            for &(block, at) in &task.blocks {
                let block = &blocks[block as usize];
                for (column, i) in block.free_columns().enumerate() {
                    kept[at + i] = x[block.first_column + column];
                }
            }
            *part = vec![0.0; task.vector_len];
            for landmark in task.landmarks.iter().filter(|landmark| landmark.dof > 0) {
                let stash = LandmarkStash::of(self.memory, landmark, task);
                let pattern_blocks = task.patterns.blocks_of(landmark);
                let mut buffer = [0.0; MAX_ELIMINATED_DOF];
                let product = &mut buffer[..landmark.dof as usize];
                stash.y.multiply(pattern_blocks, &kept, product);
                stash.y.multiply_transposed(pattern_blocks, product, part);
            }
        });
        for (task, part) in self.structure.tasks.iter().zip(&parts) {
            for &(block, at) in &task.blocks {
                let block = &blocks[block as usize];
                for (column, i) in block.free_columns().enumerate() {
                    y[block.first_column + column] -= part[at + i];
                }
            }
        }
    }

    /// Subtracts the diagonal blocks of YᵀY from full row-major blocks, which begin at `first`.
    /// Only the lower triangles are valid.
    pub(super) fn subtract_diagonal(self, first: &[usize], numbers: &mut [f64]) {
        let blocks = &self.structure.blocks;
        let mut parts: Vec<Vec<f64>> = vec![Vec::new(); self.structure.tasks.len()];
        for_each_task(&self.structure.tasks, &mut parts, |task, part| {
            *part = self.diagonal(task);
        });
        for (task, part) in self.structure.tasks.iter().zip(&parts) {
            let mut at = 0;
            for &(block, _) in &task.blocks {
                let ColumnBlock { dof, .. } = blocks[block as usize];
                let (n, free) = (blocks[block as usize].num_free(), &blocks[block as usize]);
                let numbers = &mut numbers[first[block as usize]..][..n * n];
                for (row, i) in free.free_columns().enumerate() {
                    for (column, j) in free.free_columns().enumerate().take(row + 1) {
                        numbers[row * n + column] -= part[at + i * dof + j];
                    }
                }
                at += dof * dof;
            }
        }
    }

    /// The diagonal blocks of a task's YᵀY, row by row.
    fn diagonal(self, task: &Task) -> Vec<f64> {
        let blocks = &self.structure.blocks;
        let mut starts = vec![0];
        for &(block, _) in &task.blocks {
            starts.push(starts[starts.len() - 1] + blocks[block as usize].dof.pow(2));
        }
        let mut sums = vec![0.0; starts[task.blocks.len()]];
        for landmark in task.landmarks.iter().filter(|landmark| landmark.dof > 0) {
            let stash = LandmarkStash::of(self.memory, landmark, task);
            for pattern_block in task.patterns.blocks_of(landmark) {
                let index =
                    task.blocks.partition_point(|block| block.1 < pattern_block.vector_offset);
                let sums = &mut sums[starts[index]..][..pattern_block.dof * pattern_block.dof];
                for k in 0..landmark.dof as usize {
                    let y = |i| {
                        stash.y.get(
                            landmark.dof as usize * pattern_block.packed_offset
                                + k * pattern_block.dof
                                + i,
                        )
                    };
                    for (i, sums) in sums.chunks_exact_mut(pattern_block.dof).enumerate() {
                        sums.iter_mut().enumerate().for_each(|(j, sum)| *sum += y(i) * y(j));
                    }
                }
            }
        }
        sums
    }
}
