//! The reduced system over the kept variables: put together from the chunks' tiles, then
//! factorised, dense or sparse, or solved iteratively, put together or not.
//!
//! Only the lower triangle is stored, by block columns, each one contiguous, so that columns can be
//! filled in parallel.

mod columns;
mod conjugate;
mod dense;
mod factorisation;
mod implicit;
mod sparse;

use rayon::prelude::*;

use crate::damping::marquardt;
use crate::eliminate::Sums;
use crate::structure::{Block, Structure, padded, tile_index, tile_lanes};

pub(crate) use columns::Columns;
pub(crate) use conjugate::Conjugate;
pub(crate) use dense::Dense;
pub(crate) use factorisation::Factorisation;
use factorisation::NotPositive;
pub(crate) use implicit::Eliminated;
pub(crate) use sparse::Sparse;

/// How far steps are solved for iteratively. A tenth of it hardly changes what a step achieves; ten
/// times it does.
const STEP_ACCURACY: f64 = 1e-5;
/// The same for solutions that are wanted for themselves.
const ACCURACY: f64 = 1e-12;

/// The reduced system.
pub(crate) struct Reduced {
    numbers: Vec<f64>,
    factorisation: Box<dyn Factorisation>,
    /// For each block column, which tiles of which chunks go there, chunk by chunk.
    contributions: Vec<Vec<(u32, std::ops::Range<u32>)>>,
    /// g_c over all blocks.
    pub(crate) gradient: Vec<f64>,
    correction: Vec<f64>,
    /// The diagonal of J_cᵀJ_c over all blocks.
    pub(crate) diagonal: Vec<f64>,
    solution: Vec<f64>,
}

impl Reduced {
    pub(crate) fn new(structure: &Structure, factorisation: Box<dyn Factorisation>) -> Self {
        let mut contributions = vec![Vec::new(); structure.blocks.len()];
        for (c, chunk) in structure.chunks.iter().enumerate() {
            let mut start = 0;
            for column in chunk.tiles.chunk_by(|s, t| s.a == t.a) {
                let end = start + column.len() as u32;
                contributions[column[0].a as usize].push((c as u32, start..end));
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
            numbers: vec![0.0; len],
            factorisation,
            contributions,
            gradient: zeros.clone(),
            correction: zeros.clone(),
            diagonal: zeros,
            solution: vec![0.0; structure.columns],
        }
    }

    /// Adds up what the chunks have summed, in their order, and the damping.
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
            for (chunk, sums) in structure.chunks.iter().zip(sums) {
                for &(block, at) in &chunk.blocks {
                    let Block { dof, at: to_at, .. } = structure.blocks[block as usize];
                    let from = &sums.vectors[3 * at + part * padded(dof)..];
                    for (to, from) in to[to_at..][..dof].iter_mut().zip(from) {
                        *to += from;
                    }
                }
            }
        }
        let mut columns = Vec::with_capacity(structure.blocks.len());
        let mut rest = &mut self.numbers[..];
        for a in 0..structure.blocks.len() {
            let (column, others) = rest.split_at_mut(self.factorisation.block_column(a).len());
            columns.push((a, column));
            rest = others;
        }
        let (layout, diagonal, contributions) =
            (&self.factorisation, &self.diagonal, &self.contributions);
        let fill = |(a, numbers): (usize, &mut [f64])| {
            numbers.fill(0.0);
            let block = &structure.blocks[a];
            for (c, tiles) in &contributions[a] {
                let chunk = &structure.chunks[*c as usize];
                for tile in &chunk.tiles[tiles.start as usize..tiles.end as usize] {
                    let tile_numbers = &memory[chunk.memory.start + tile.at..];
                    add_tile(
                        &**layout,
                        &structure.blocks,
                        (a, tile.b as usize),
                        tile_numbers,
                        numbers,
                    );
                }
            }
            for (column, i) in block.free_columns().enumerate() {
                let at = layout.tile_at(a, a, column);
                numbers[at] += marquardt(diagonal[block.at + i], lambda);
            }
        };
        if structure.chunks.len() > 1 {
            columns.into_par_iter().for_each(fill);
        } else {
            columns.into_iter().for_each(fill);
        }
    }

    /// Factorises and solves for the step of the kept variables, written over all blocks, fixed
    /// columns zero.
    pub(crate) fn solve(
        &mut self,
        rest: Eliminated<'_>,
        step: &mut [f64],
    ) -> Result<(), NotPositive> {
        self.factorise(rest)?;
        let structure = rest.structure;
        for block in &structure.blocks {
            for (column, i) in block.free_columns().enumerate() {
                let at = block.at + i;
                self.solution[block.reduced + column] = self.correction[at] - self.gradient[at];
            }
        }
        self.factorisation.solve(&self.numbers, rest, &mut self.solution, STEP_ACCURACY);
        for block in &structure.blocks {
            for (column, i) in block.free_columns().enumerate() {
                step[block.at + i] = self.solution[block.reduced + column];
            }
        }
        Ok(())
    }

    /// Factorises what was gathered.
    pub(crate) fn factorise(&mut self, rest: Eliminated<'_>) -> Result<(), NotPositive> {
        self.factorisation.factorise(&mut self.numbers, rest)
    }

    /// Solves the factorised system for several right-hand sides over its columns.
    pub(crate) fn solve_columns(&mut self, rest: Eliminated<'_>, x: &mut [f64]) {
        self.factorisation.solve(&self.numbers, rest, x, ACCURACY);
    }
}

/// Adds the tile of blocks `a` and `b` to the numbers of block column `a`.
fn add_tile(
    layout: &dyn Factorisation,
    blocks: &[Block],
    (a, b): (usize, usize),
    tile: &[f64],
    numbers: &mut [f64],
) {
    let (block, other) = (&blocks[a], &blocks[b]);
    let at = |j: usize, i: usize| tile[tile_index(block.dof, other.dof, j, i)];
    for (column, j) in block.free_columns().enumerate() {
        let skip = if a == b { column } else { 0 };
        let to = &mut numbers[layout.tile_at(a, b, column)..][..other.num_free() - skip];
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
