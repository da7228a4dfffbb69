//! What is known of a problem before its numbers: blocks of the reduced system, cells to eliminate,
//! chunks of work.
//!
//! * A **block** is a stretch of columns of the reduced system: one kept variable, or several that
//!   never occur apart beside an eliminated one (a camera's own intrinsics and its pose), which
//!   then cost one product instead of four.
//! * A **cell** is one eliminated variable with all its factors, or a bunch of factors that join
//!   the same kept variables only. Its **pattern** is a sorted list of distinct blocks, those that
//!   it touches or more: products are taken over these, not over factors, and for all cells of a
//!   pattern together.
//! * A **chunk** is a stretch of cells, sorted by their blocks, that one task works through. It
//!   sums into tiles of its own, for the blocks that it touches only, and the chunks' sums are
//!   added in order. Their number depends on the problem alone, and so does every rounding error.
//!
//! A partly fixed variable keeps its full width up to here, with columns of zeros, so that blocks
//! stay uniform; the columns are left out when the reduced system is put together.

mod block;
mod build;
mod bundles;
mod cells;
mod chunk;
mod context;
mod elimination;
mod groups;
mod parallel;
mod patterns;
mod place;
mod shape;
mod shapes;
mod stash;
mod tile;

use rayon::prelude::*;

use crate::error::Error;
use crate::problem::Problem;

pub(crate) use block::{Block, NONE, Place};
use cells::{Cells, Draft};
pub(crate) use chunk::{Batch, Bundle, Cell, Chunk, Local, SINGLE_ROWS};
use context::Context;
pub(crate) use elimination::Elimination;
pub(crate) use parallel::for_chunks;
use place::{Placed, Variables};
pub(crate) use shape::{NO_OWN, Shape};
pub(crate) use stash::{row, stash_head, stash_len};
pub(crate) use tile::{padded, tile_index, tile_lanes, tile_len};

/// Enough work for a task: some 100 µs.
pub(crate) const FACTORS_PER_CHUNK: usize = 4096;
/// More tasks than cores of any machine we know would only cost memory.
const MAX_CHUNKS: usize = 64;

/// The structure of a problem.
pub(crate) struct Structure {
    pub(crate) blocks: Vec<Block>,
    /// Length of vectors over all blocks.
    pub(crate) kept_len: usize,
    /// Columns of the reduced system.
    pub(crate) columns: usize,
    pub(crate) chunks: Vec<Chunk>,
    /// How many numbers the tiles and stashes of all chunks take.
    pub(crate) memory_len: usize,
    /// Per store, per variable: where its step is, or `variable::FIXED`.
    pub(crate) step_at: Vec<Vec<u32>>,
    pub(crate) step_len: usize,
    pub(crate) places: Vec<Vec<Place>>,
}

impl Structure {
    pub(crate) fn new(problem: &Problem, elimination: Elimination) -> Result<Self, Error> {
        check_sizes(problem)?;
        let variables = Variables::of(problem, elimination);
        let scan = place::scan(problem, &variables)?;
        let Placed { blocks, places, looks } = place::place(problem, &variables, &scan);
        let cells = Cells::draft(problem, &variables, &scan, &places);
        let drafts = cells.sorted_drafts();
        let kept_len: usize = blocks.iter().map(|block| padded(block.dof)).sum();
        let mut step_len = kept_len;
        let work: usize = drafts.iter().map(Draft::work).sum();
        let count = num_chunks(cells.entries.len());
        let mut parts = Vec::with_capacity(count);
        let (mut rest, mut done) = (&drafts[..], 0);
        while !rest.is_empty() {
            // Each ends where its share of the work does, which evens out what the ones before got
            // wrong.
            let end = (work * (parts.len() + 1)).div_ceil(count);
            let (begin, mut len) = (step_len, 0);
            while let Some(draft) = rest.get(len).filter(|_| done < end) {
                done += draft.work();
                step_len += draft.dof as usize;
                len += 1;
            }
            let (these, others) = rest.split_at(len);
            rest = others;
            parts.push((these, begin));
        }
        let context =
            Context { problem, blocks: &blocks, looks: &looks, cells: &cells, elimination };
        // Of several errors, the first in order.
        let chunks: Vec<Result<Chunk, Error>> = parts
            .into_par_iter()
            .with_max_len(1)
            .map(|(these, step)| build::build(&context, these, step))
            .collect();
        let mut chunks = chunks.into_iter().collect::<Result<Vec<_>, _>>()?;
        let mut memory_len = 0;
        for chunk in &mut chunks {
            // Whole cache lines, so that no two chunks write to the same.
            let len = (chunk.tiles_len + chunk.stash_len).next_multiple_of(8);
            chunk.memory = memory_len..memory_len + len;
            memory_len += len;
        }
        let mut step_at: Vec<Vec<u32>> = (places.iter())
            .map(|places| {
                let at = |place: &Place| match place.block {
                    NONE => crate::variable::FIXED,
                    block => (blocks[block as usize].at as u32) + place.offset,
                };
                places.iter().map(at).collect()
            })
            .collect();
        for cell in chunks.iter().flat_map(|chunk| &chunk.cells).filter(|cell| cell.dof > 0) {
            step_at[cell.store as usize][cell.slot as usize] = cell.step as u32;
        }
        let columns = blocks.iter().map(Block::num_free).sum();
        Ok(Self { blocks, kept_len, columns, chunks, memory_len, step_at, step_len, places })
    }

    /// Numbers in all Y.
    pub(crate) fn num_coupled(&self) -> usize {
        let of_chunk = |chunk: &Chunk| -> usize {
            let of_cell = |cell: &Cell| cell.dof as usize * chunk.patterns.of(cell).dense;
            chunk.cells.iter().map(of_cell).sum()
        };
        self.chunks.iter().map(of_chunk).sum()
    }

    /// All pairs of blocks that some tile joins, sorted.
    pub(crate) fn tile_pairs(&self) -> Vec<(u32, u32)> {
        let mut pairs: Vec<_> = self
            .chunks
            .iter()
            .flat_map(|chunk| chunk.tiles.iter().map(|tile| (tile.a, tile.b)))
            .collect();
        pairs.extend((0..self.blocks.len() as u32).map(|block| (block, block)));
        pairs.sort_unstable();
        pairs.dedup();
        pairs
    }
}

/// Into how many chunks so many factors are cut. Several fall evenly on two or four threads.
fn num_chunks(factors: usize) -> usize {
    let chunks = factors.div_ceil(FACTORS_PER_CHUNK).max(1);
    if chunks == 1 { 1 } else { chunks.next_multiple_of(4).min(MAX_CHUNKS) }
}

fn check_sizes(problem: &Problem) -> Result<(), Error> {
    let check = |what, count, limit| {
        if count > limit { Err(Error::TooLarge { what, count, limit }) } else { Ok(()) }
    };
    let limit = u32::MAX as usize - 1;
    check("factors", problem.num_factors(), limit)?;
    let numbers = problem.values.stores.iter().map(|store| store.len() * store.dof()).sum();
    check("degrees of freedom", numbers, limit / 2)?;
    check("factor types", problem.runs.len(), u16::MAX as usize)
}
