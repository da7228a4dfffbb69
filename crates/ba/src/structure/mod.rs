//! What is known of a problem before its numbers: blocks of the reduced system, cells to eliminate, chunks of work.
//!
//! * A **block** is a stretch of columns of the reduced system: one kept variable, or several that never occur apart beside an
//!   eliminated one (a camera's own intrinsics and its pose), which then cost one product instead of four.
//! * A **cell** is one eliminated variable with all its factors, or a bunch of factors that join the same kept variables only.
//!   Its **pattern** is a sorted list of distinct blocks, those that it touches or more: products are taken over these, not over
//!   factors, and for all cells of a pattern together.
//! * A **chunk** is a stretch of cells, sorted by their blocks, that one task works through. It sums into tiles of its own,
//!   for the blocks that it touches only, and the chunks' sums are added in order. Their number depends on the problem
//!   alone, and so does every rounding error.
//!
//! A partly fixed variable keeps its full width up to here, with columns of zeros, so that blocks stay uniform; the columns are
//! left out when the reduced system is put together.

mod bundles;
mod cells;
mod chunk;
mod groups;
mod place;
mod shape;

use rayon::prelude::*;

use crate::error::Error;
use crate::problem::Problem;

use cells::{Cells, Draft};
use place::{Placed, Variables};

/// Enough work for a task: some 100 µs.
pub(crate) const FACTORS_PER_CHUNK: usize = 4096;
/// More tasks than cores of any machine we know would only cost memory.
const MAX_CHUNKS: usize = 64;
/// "There is none."
pub(crate) const NONE: u32 = u32::MAX;

/// In place of a variable's position in a factor: none of them is eliminated.
pub(crate) const NO_OWN: u8 = u8::MAX;

/// Numbers per row of storage: a multiple of the vector width that all instruction sets share.
pub(crate) fn padded(dof: usize) -> usize {
    dof.next_multiple_of(4)
}

/// Numbers in a column of a tile whose rows belong to a block of so many directions. Where one direction is left over beside
/// vectors of eight, it is not in the columns but has a row behind them.
#[inline(always)]
pub(crate) fn tile_lanes(dof: usize) -> usize {
    if dof % 8 == 1 { dof - 1 } else { padded(dof) }
}

/// Numbers in a tile of blocks with so many directions.
#[inline(always)]
pub(crate) fn tile_len(a: usize, b: usize) -> usize {
    a * tile_lanes(b) + if tile_lanes(b) < b { padded(a) } else { 0 }
}

/// Where in such a tile a number is.
#[inline(always)]
pub(crate) fn tile_index(a: usize, b: usize, column: usize, row: usize) -> usize {
    let lanes = tile_lanes(b);
    if row < lanes { column * lanes + row } else { a * lanes + column }
}

/// A stretch of columns of the reduced system.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    pub(crate) dof: usize,
    /// Where its numbers begin in vectors over all blocks, where each takes `padded(dof)`.
    pub(crate) at: usize,
    /// Bit i: column i is free.
    pub(crate) free: u64,
    /// First of its free columns in the reduced system.
    pub(crate) reduced: usize,
}

impl Block {
    /// The free columns, in order.
    pub(crate) fn free_columns(&self) -> impl Iterator<Item = usize> + use<> {
        let free = self.free;
        (0..self.dof).filter(move |&column| free >> column & 1 == 1)
    }
    pub(crate) fn num_free(&self) -> usize {
        self.free.count_ones() as usize
    }
    pub(crate) fn whole(&self) -> bool {
        self.num_free() == self.dof
    }
}

/// Where a variable went: its block and the first column in it. `block == NONE`: fixed, or eliminated.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub(crate) block: u32,
    pub(crate) offset: u32,
    /// Variables with the same number look the same to a factor's [`Shape`].
    class: u32,
}

/// Columns of one block in a factor's rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Segment {
    /// First column in the rows.
    pub(crate) column: usize,
    pub(crate) dof: usize,
    /// First column in the block.
    pub(crate) offset: usize,
    /// Columns of the block.
    pub(crate) block_dof: usize,
    /// Whether it is the whole block.
    pub(crate) whole: bool,
}

/// How the rows of a factor fall into blocks: few of these serve all factors.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Shape {
    pub(crate) run: u16,
    /// Which of the factor's variables is the eliminated one, or [`NO_OWN`].
    pub(crate) own: u8,
    pub(crate) rows: usize,
    pub(crate) stride: usize,
    /// Column of the residual.
    pub(crate) residual: usize,
    pub(crate) segments: Vec<Segment>,
    /// First column of the eliminated variable.
    pub(crate) eliminated: usize,
    /// Columns of directions that are held fixed in variables that move otherwise.
    pub(crate) held: Vec<usize>,
}

/// One of the blocks of a pattern.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Local {
    pub(crate) dof: usize,
    pub(crate) padded: usize,
    /// Where its numbers begin in the chunk's vectors.
    pub(crate) at: usize,
    /// Where its numbers begin in a row over the pattern's blocks.
    pub(crate) column: usize,
    /// The same without padding.
    pub(crate) dense: usize,
}

impl Local {
    /// Its degrees of freedom: `D`, where that is known to the compiler and not 0.
    #[inline(always)]
    pub(crate) fn dof_or<const D: usize>(&self) -> usize {
        if D > 0 { D } else { self.dof }
    }
}

/// The blocks of some cells.
#[derive(Clone, Debug)]
pub(crate) struct Pattern {
    /// First and last of its [`Local`]s.
    pub(crate) locals: std::ops::Range<usize>,
    /// Where its offsets of tiles begin: of the pair i ≤ j at `j (j + 1) / 2 + i`.
    pub(crate) pairs: usize,
    /// Sum of `padded` over its blocks.
    pub(crate) width: usize,
    /// Sum of `dof` over its blocks.
    pub(crate) dense: usize,
    /// That of every block; 0 where they differ.
    pub(crate) dof: usize,
}

/// An eliminated variable with its factors, or factors without one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cell {
    pub(crate) pattern: u32,
    /// Degrees of freedom of the eliminated variable; 0 where there is none.
    pub(crate) dof: u32,
    /// It is a point, and each factor has [`SINGLE_ROWS`] and sees the whole of one block, that no other one of the cell sees.
    pub(crate) single: bool,
    pub(crate) store: u32,
    pub(crate) slot: u32,
    /// Its factors end here in the chunk's list.
    pub(crate) end: u32,
    /// Where its numbers begin in the chunk's stash.
    pub(crate) stash: usize,
    /// Where its step begins in the step of the whole problem.
    pub(crate) step: usize,
}

/// A stretch of factors of one run, with the eliminated variable in one place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stretch {
    pub(crate) run: u16,
    /// Which of the factors' variables is the eliminated one, or [`NO_OWN`].
    pub(crate) own: u8,
    pub(crate) start: usize,
    pub(crate) end: usize,
}

/// A product of two blocks, a ≤ b: [`tile_len`] numbers, beginning at `at`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tile {
    pub(crate) a: u32,
    pub(crate) b: u32,
    pub(crate) at: usize,
}

/// What is linearised at once.
#[derive(Clone, Debug, Default)]
pub(crate) struct Batch {
    pub(crate) stretches: std::ops::Range<usize>,
    pub(crate) cells: std::ops::Range<usize>,
    pub(crate) bundles: std::ops::Range<usize>,
}

/// Factors of a batch that have the same shape and see the same blocks: their part of C is one product. Those of
/// [`single`](Cell::single) cells are in none.
#[derive(Clone, Debug)]
pub(crate) struct Bundle {
    pub(crate) shape: u16,
    /// In the chunk's list: for each segment of the shape where its block's numbers begin in the chunk's vectors, then the tile of
    /// each pair of segments, that of i ≤ j at `j (j + 1) / 2 + i`.
    pub(crate) places: usize,
    /// In the chunk's list: where each of the rows begins in the batch.
    pub(crate) rows: std::ops::Range<usize>,
}

/// The work of one task.
#[derive(Clone, Debug)]
pub(crate) struct Chunk {
    pub(crate) elimination: Elimination,
    /// Number of each factor in its run.
    pub(crate) factors: Vec<u32>,
    /// Their shapes, as numbers in `shapes`.
    pub(crate) shape_of: Vec<u16>,
    pub(crate) shapes: Vec<Shape>,
    /// For each factor, for each segment of its shape: which of the pattern's blocks.
    pub(crate) locals: Vec<u16>,
    pub(crate) cells: Vec<Cell>,
    pub(crate) stretches: Vec<Stretch>,
    pub(crate) batches: Vec<Batch>,
    pub(crate) bundles: Vec<Bundle>,
    pub(crate) bundle_places: Vec<u32>,
    pub(crate) bundle_rows: Vec<u32>,
    pub(crate) patterns: Vec<Pattern>,
    pub(crate) pattern_locals: Vec<Local>,
    /// [`NONE`] where there is no tile.
    pub(crate) pair_tiles: Vec<u32>,
    /// The blocks that it touches, in order, and where their numbers begin in its vectors.
    pub(crate) blocks: Vec<(u32, usize)>,
    pub(crate) vector_len: usize,
    /// The tiles that it touches, in order.
    pub(crate) tiles: Vec<Tile>,
    pub(crate) tiles_len: usize,
    pub(crate) stash_len: usize,
    /// Its tiles and its stash in the memory of all chunks.
    pub(crate) memory: std::ops::Range<usize>,
    /// Its eliminated variables' part of the step.
    pub(crate) steps: std::ops::Range<usize>,
    pub(crate) rows_len: usize,
}

impl Chunk {
    fn new(elimination: Elimination, first_step: usize) -> Self {
        Self {
            elimination,
            factors: Vec::new(),
            shape_of: Vec::new(),
            shapes: Vec::new(),
            locals: Vec::new(),
            cells: Vec::new(),
            stretches: Vec::new(),
            batches: Vec::new(),
            bundles: Vec::new(),
            bundle_places: Vec::new(),
            bundle_rows: Vec::new(),
            patterns: Vec::new(),
            pattern_locals: Vec::new(),
            pair_tiles: Vec::new(),
            blocks: Vec::new(),
            vector_len: 0,
            tiles: Vec::new(),
            tiles_len: 0,
            stash_len: 0,
            memory: 0..0,
            steps: first_step..first_step,
            rows_len: 0,
        }
    }

    /// The factors of one of its cells.
    pub(crate) fn factors_of(&self, cell: usize) -> std::ops::Range<usize> {
        let start = cell.checked_sub(1).map_or(0, |previous| self.cells[previous].end);
        start as usize..self.cells[cell].end as usize
    }

    /// The run of one of its factors.
    pub(crate) fn run_of(&self, factor: usize) -> usize {
        self.shapes[self.shape_of[factor] as usize].run as usize
    }
}

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

/// What becomes of the variables that are declared eliminated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Elimination {
    /// Kept like the others, for solvers that see the whole Jacobian.
    Ignore,
    /// Eliminated.
    Do,
    /// The same, and the reduced system is never put together: tiles are of C alone.
    Implicit,
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
            // Each ends where its share of the work does, which evens out what the ones before got wrong.
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
        let context = chunk::Context { problem, blocks: &blocks, looks: &looks, cells: &cells, elimination };
        // Of several errors, the first in order.
        let chunks: Vec<Result<Chunk, Error>> = parts
            .into_par_iter()
            .with_max_len(1)
            .map(|(these, step)| chunk::build(&context, these, step))
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
            let of_cell = |cell: &Cell| cell.dof as usize * chunk.patterns[cell.pattern as usize].dense;
            chunk.cells.iter().map(of_cell).sum()
        };
        self.chunks.iter().map(of_chunk).sum()
    }

    /// All pairs of blocks that some tile joins, sorted.
    pub(crate) fn tile_pairs(&self) -> Vec<(u32, u32)> {
        let mut pairs: Vec<_> =
            self.chunks.iter().flat_map(|chunk| chunk.tiles.iter().map(|tile| (tile.a, tile.b))).collect();
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
    let check =
        |what, count, limit| if count > limit { Err(Error::TooLarge { what, count, limit }) } else { Ok(()) };
    let limit = u32::MAX as usize - 1;
    check("factors", problem.num_factors(), limit)?;
    let numbers = problem.values.stores.iter().map(|store| store.len() * store.dof()).sum();
    check("degrees of freedom", numbers, limit / 2)?;
    check("factor types", problem.runs.len(), u16::MAX as usize)
}
