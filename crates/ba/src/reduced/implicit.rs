//! The reduced system without putting it together: S x = C x − Yᵀ(Y x), cell by cell, from what
//! elimination has stashed. Nothing fills in, neither by factorisation nor by points that many
//! cameras see: the numbers are as many as the observations (Agarwal, Snavely, Seitz, Szeliski
//! 2010, "Bundle adjustment in the large", section 3.3).
//!
//! C, the kept variables' own part, is put together as ever, from tiles of blocks that share a
//! factor.

use crate::eliminate::CellStash;
use crate::structure::{Block, Chunk, Structure, for_chunks};
use crate::variable::MAX_ELIMINATED_DOF;

/// What the elimination has left.
#[derive(Clone, Copy)]
pub(crate) struct Eliminated<'a> {
    pub(crate) structure: &'a Structure,
    /// Tiles and stashes of all chunks.
    pub(crate) memory: &'a [f64],
}

impl Eliminated<'_> {
    /// y −= Yᵀ Y x over the columns of the reduced system. The chunks' sums are subtracted in their
    /// order.
    pub(super) fn subtract_product(self, x: &[f64], y: &mut [f64]) {
        let blocks = &self.structure.blocks;
        let mut parts: Vec<Vec<f64>> = vec![Vec::new(); self.structure.chunks.len()];
        for_chunks(&self.structure.chunks, &mut parts, |chunk, part| {
            let mut kept = vec![0.0; chunk.vector_len];
            for &(block, at) in &chunk.blocks {
                let block = &blocks[block as usize];
                for (column, i) in block.free_columns().enumerate() {
                    kept[at + i] = x[block.reduced + column];
                }
            }
            *part = vec![0.0; chunk.vector_len];
            for cell in chunk.cells.iter().filter(|cell| cell.dof > 0) {
                let stash = CellStash::of(self.memory, cell, chunk);
                let locals = chunk.patterns.locals_of(cell);
                let mut room = [0.0; MAX_ELIMINATED_DOF];
                let product = &mut room[..cell.dof as usize];
                stash.y.multiply(locals, &kept, product);
                stash.y.multiply_transposed(locals, product, part);
            }
        });
        for (chunk, part) in self.structure.chunks.iter().zip(&parts) {
            for &(block, at) in &chunk.blocks {
                let block = &blocks[block as usize];
                for (column, i) in block.free_columns().enumerate() {
                    y[block.reduced + column] -= part[at + i];
                }
            }
        }
    }

    /// Subtracts the blocks of YᵀY on the diagonal from full blocks, row by row, of which only the
    /// lower triangle is meant; each begins where `first` says.
    pub(super) fn subtract_diagonal(self, first: &[usize], numbers: &mut [f64]) {
        let blocks = &self.structure.blocks;
        let mut parts: Vec<Vec<f64>> = vec![Vec::new(); self.structure.chunks.len()];
        for_chunks(&self.structure.chunks, &mut parts, |chunk, part| {
            *part = self.diagonal(chunk);
        });
        for (chunk, part) in self.structure.chunks.iter().zip(&parts) {
            let mut at = 0;
            for &(block, _) in &chunk.blocks {
                let Block { dof, .. } = blocks[block as usize];
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

    /// The diagonal blocks of a chunk's YᵀY, row by row.
    fn diagonal(self, chunk: &Chunk) -> Vec<f64> {
        let blocks = &self.structure.blocks;
        let mut starts = vec![0];
        for &(block, _) in &chunk.blocks {
            starts.push(starts[starts.len() - 1] + blocks[block as usize].dof.pow(2));
        }
        let mut sums = vec![0.0; starts[chunk.blocks.len()]];
        for cell in chunk.cells.iter().filter(|cell| cell.dof > 0) {
            let stash = CellStash::of(self.memory, cell, chunk);
            for local in chunk.patterns.locals_of(cell) {
                let index = chunk.blocks.partition_point(|block| block.1 < local.at);
                let sums = &mut sums[starts[index]..][..local.dof * local.dof];
                for k in 0..cell.dof as usize {
                    let y = |i| stash.y.get(cell.dof as usize * local.dense + k * local.dof + i);
                    for (i, sums) in sums.chunks_exact_mut(local.dof).enumerate() {
                        sums.iter_mut().enumerate().for_each(|(j, sum)| *sum += y(i) * y(j));
                    }
                }
            }
        }
        sums
    }
}
