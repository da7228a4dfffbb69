//! The reduced system (Schur complement) over the kept variables: summed from the tiles of the
//! tasks, then solved by dense or sparse Cholesky factorisation or by conjugate gradients, or
//! solved iteratively without forming it.
//!
//! Only the lower triangle is stored, by contiguous block columns, so that columns can be filled in
//! parallel.

mod columns;
mod conjugate;
mod dense;
mod factorisation;
mod implicit;
mod sparse;

use rayon::prelude::*;

use crate::damping::marquardt;
use crate::eliminate::Sums;
use crate::structure::{ColumnBlock, Structure, padded, tile_index, tile_lanes};

pub(crate) use columns::Columns;
pub(crate) use conjugate::ConjugateGradients;
pub(crate) use dense::Dense;
pub(crate) use factorisation::Factorisation;
use factorisation::NotPositive;
pub(crate) use implicit::EliminatedSystem;
pub(crate) use sparse::Sparse;

/// Accuracy of iterative solutions for steps. A tenth of it hardly changes the decrease of the
/// cost; ten times as much does.
const STEP_ACCURACY: f64 = 1e-5;
/// Accuracy of iterative solutions for covariances.
const ACCURACY: f64 = 1e-12;

/// The reduced system.
pub(crate) struct Reduced {
    lower: Vec<f64>,
    factorisation: Box<dyn Factorisation>,
    /// For each block column: the tasks that have tiles in it, and the range of these tiles.
    tile_sources: Vec<Vec<(u32, std::ops::Range<u32>)>>,
    /// g_c over all blocks.
    pub(crate) gradient: Vec<f64>,
    correction: Vec<f64>,
    /// The diagonal of J_cᵀJ_c over all blocks.
    pub(crate) diagonal: Vec<f64>,
    solution: Vec<f64>,
}

impl Reduced {
    pub(crate) fn new(structure: &Structure, factorisation: Box<dyn Factorisation>) -> Self {
        let mut tile_sources = vec![Vec::new(); structure.blocks.len()];
        for (c, task) in structure.tasks.iter().enumerate() {
            let mut start = 0;
            for column in task.tiles.chunk_by(|s, t| s.a == t.a) {
                let end = start + column.len() as u32;
                tile_sources[column[0].a as usize].push((c as u32, start..end));
                start = end;
            }
        }
        let len = structure
            .blocks
            .len()
            .checked_sub(1)
            .map_or(0, |last| factorisation.block_column(last).end);
        let zeros = vec![0.0; structure.kept_len];
        Self {
            lower: vec![0.0; len],
            factorisation,
            tile_sources,
            gradient: zeros.clone(),
            correction: zeros.clone(),
            diagonal: zeros,
            solution: vec![0.0; structure.columns],
        }
    }

    /// Adds the tiles and vectors of all tasks, in order, and the damping.
    pub(crate) fn gather(
        &mut self,
        structure: &Structure,
        sums: &[Sums],
        memory: &[f64],
        lambda: f64,
    ) {
        for (part, to) in
            [&mut self.gradient, &mut self.correction, &mut self.diagonal].into_iter().enumerate()
        {
            to.fill(0.0);
            for (task, sums) in structure.tasks.iter().zip(sums) {
                for &(block, at) in &task.blocks {
                    let ColumnBlock { dof, padded_start: to_at, .. } =
                        structure.blocks[block as usize];
                    let from = &sums.vectors[3 * at + part * padded(dof)..];
                    for (to, from) in to[to_at..][..dof].iter_mut().zip(from) {
                        *to += from;
                    }
                }
            }
        }
        let mut columns = Vec::with_capacity(structure.blocks.len());
        let mut rest = &mut self.lower[..];
        for a in 0..structure.blocks.len() {
            let (column, others) = rest.split_at_mut(self.factorisation.block_column(a).len());
            columns.push((a, column));
            rest = others;
        }
        let (layout, diagonal, tile_sources) =
            (&self.factorisation, &self.diagonal, &self.tile_sources);
        let fill = |(a, lower): (usize, &mut [f64])| {
            lower.fill(0.0);
            let block = &structure.blocks[a];
            for (c, tiles) in &tile_sources[a] {
                let task = &structure.tasks[*c as usize];
                for tile in &task.tiles[tiles.start as usize..tiles.end as usize] {
                    let tile_numbers = &memory[task.memory.start + tile.at..];
                    add_tile(
                        &**layout,
                        &structure.blocks,
                        (a, tile.b as usize),
                        tile_numbers,
                        lower,
                    );
                }
            }
            for (column, i) in block.free_columns().enumerate() {
                let at = layout.tile_at(a, a, column);
                lower[at] += marquardt(diagonal[block.padded_start + i], lambda);
            }
        };
        if structure.tasks.len() > 1 {
            columns.into_par_iter().for_each(fill);
        } else {
            columns.into_iter().for_each(fill);
        }
    }

    /// Factorises and solves for the step of the kept variables, written as a padded vector over
    /// all blocks. Fixed columns are not written.
    pub(crate) fn solve(
        &mut self,
        eliminated: EliminatedSystem<'_>,
        step: &mut [f64],
    ) -> Result<(), NotPositive> {
        self.factorise(eliminated)?;
        let structure = eliminated.structure;
        for block in &structure.blocks {
            for (column, i) in block.free_columns().enumerate() {
                let at = block.padded_start + i;
                self.solution[block.first_column + column] =
                    self.correction[at] - self.gradient[at];
            }
        }
        self.factorisation.solve(&self.lower, eliminated, &mut self.solution, STEP_ACCURACY);
        for block in &structure.blocks {
            for (column, i) in block.free_columns().enumerate() {
                step[block.padded_start + i] = self.solution[block.first_column + column];
            }
        }
        Ok(())
    }

    /// Factorises the gathered system.
    pub(crate) fn factorise(
        &mut self,
        eliminated: EliminatedSystem<'_>,
    ) -> Result<(), NotPositive> {
        self.factorisation.factorise(&mut self.lower, eliminated)
    }

    /// Solves the factorised system for several right-hand sides over its columns.
    pub(crate) fn solve_columns(&mut self, eliminated: EliminatedSystem<'_>, x: &mut [f64]) {
        self.factorisation.solve(&self.lower, eliminated, x, ACCURACY);
    }
}

/// Adds the tile of blocks `a` and `b` to block column `a`.
fn add_tile(
    layout: &dyn Factorisation,
    blocks: &[ColumnBlock],
    (a, b): (usize, usize),
    tile: &[f64],
    lower: &mut [f64],
) {
    let (block, other) = (&blocks[a], &blocks[b]);
    let at = |j: usize, i: usize| tile[tile_index(block.dof, other.dof, j, i)];
    for (column, j) in block.free_columns().enumerate() {
        let skip = if a == b { column } else { 0 };
        let to = &mut lower[layout.tile_at(a, b, column)..][..other.num_free() - skip];
        if other.whole() {
            let lanes = tile_lanes(other.dof).min(other.dof);
            let column = &tile[j * tile_lanes(other.dof)..][..lanes];
            for (to, from) in to.iter_mut().zip(column.get(skip..).unwrap_or_default()) {
                *to += from;
            }
            if lanes < other.dof
                && let Some(to) = to.last_mut()
            {
                *to += at(j, lanes);
            }
        } else {
            for (to, i) in to.iter_mut().zip(other.free_columns().skip(skip)) {
                *to += at(j, i);
            }
        }
    }
}
