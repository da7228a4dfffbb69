//! The work of one task: cells with their factors, and the patterns, batches and tiles through
//! which it passes.

use std::ops::Range;

use super::elimination::Elimination;
use super::shape::Shape;
use super::tile::Tile;

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
    pub(crate) locals: Range<usize>,
    /// Where its offsets of tiles begin: of the pair i ≤ j at `j (j + 1) / 2 + i`.
    pub(crate) pairs: usize,
    /// Sum of `padded` over its blocks.
    pub(crate) width: usize,
    /// Sum of `dof` over its blocks.
    pub(crate) dense: usize,
    /// That of every block; 0 where they differ.
    pub(crate) dof: usize,
}

/// Rows of each factor of a [`single`](Cell::single) cell.
pub(crate) const SINGLE_ROWS: usize = 2;

/// An eliminated variable with its factors, or factors without one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cell {
    pub(crate) pattern: u32,
    /// Degrees of freedom of the eliminated variable; 0 where there is none.
    pub(crate) dof: u32,
    /// It is a point, and each factor has [`SINGLE_ROWS`] and sees the whole of one block, that no
    /// other one of the cell sees.
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

/// What is linearised at once.
#[derive(Clone, Debug, Default)]
pub(crate) struct Batch {
    pub(crate) stretches: Range<usize>,
    pub(crate) cells: Range<usize>,
    pub(crate) bundles: Range<usize>,
}

/// Factors of a batch that have the same shape and see the same blocks: their part of C is one
/// product. Those of [`single`](Cell::single) cells are in none.
#[derive(Clone, Debug)]
pub(crate) struct Bundle {
    pub(crate) shape: u16,
    /// In the chunk's list: for each segment of the shape where its block's numbers begin in the
    /// chunk's vectors, then the tile of each pair of segments, that of i ≤ j at
    /// `j (j + 1) / 2 + i`.
    pub(crate) places: usize,
    /// In the chunk's list: where each of the rows begins in the batch.
    pub(crate) rows: Range<usize>,
}

/// The factors of a chunk, cell by cell.
#[derive(Clone, Debug, Default)]
pub(crate) struct Factors {
    /// Number of each in its run.
    pub(crate) numbers: Vec<u32>,
    /// Their shapes, as numbers in `shapes`.
    pub(crate) shape_of: Vec<u16>,
    pub(crate) shapes: Vec<Shape>,
    /// For each factor, for each segment of its shape: which of the pattern's blocks.
    pub(crate) locals: Vec<u16>,
}

impl Factors {
    #[inline(always)]
    pub(crate) fn shape(&self, factor: usize) -> &Shape {
        &self.shapes[self.shape_of[factor] as usize]
    }
}

/// The patterns of a chunk's cells.
#[derive(Clone, Debug, Default)]
pub(crate) struct Patterns {
    pub(crate) list: Vec<Pattern>,
    /// The blocks of each.
    pub(crate) locals: Vec<Local>,
    /// Offsets of tiles, see [`Pattern::pairs`]; [`NONE`](super::block::NONE) where there is no
    /// tile.
    pub(crate) pair_tiles: Vec<u32>,
}

impl Patterns {
    #[inline(always)]
    pub(crate) fn of(&self, cell: &Cell) -> &Pattern {
        &self.list[cell.pattern as usize]
    }

    #[inline(always)]
    pub(crate) fn locals_of(&self, cell: &Cell) -> &[Local] {
        &self.locals[self.of(cell).locals.clone()]
    }
}

/// The bundles of a chunk's batches.
#[derive(Clone, Debug, Default)]
pub(crate) struct Bundles {
    pub(crate) list: Vec<Bundle>,
    /// See [`Bundle::places`].
    pub(crate) places: Vec<u32>,
    /// See [`Bundle::rows`].
    pub(crate) rows: Vec<u32>,
}

/// The work of one task.
#[derive(Clone, Debug)]
pub(crate) struct Chunk {
    pub(crate) elimination: Elimination,
    pub(crate) factors: Factors,
    pub(crate) cells: Vec<Cell>,
    pub(crate) patterns: Patterns,
    pub(crate) stretches: Vec<Stretch>,
    pub(crate) batches: Vec<Batch>,
    pub(crate) bundles: Bundles,
    /// The blocks that it touches, in order, and where their numbers begin in its vectors.
    pub(crate) blocks: Vec<(u32, usize)>,
    pub(crate) vector_len: usize,
    /// The tiles that it touches, in order.
    pub(crate) tiles: Vec<Tile>,
    pub(crate) tiles_len: usize,
    pub(crate) stash_len: usize,
    /// Its tiles and its stash in the memory of all chunks.
    pub(crate) memory: Range<usize>,
    /// Its eliminated variables' part of the step.
    pub(crate) steps: Range<usize>,
    /// Numbers in the rows of its longest batch.
    pub(crate) rows_len: usize,
}

impl Chunk {
    /// An empty one, whose steps begin at `first_step`.
    pub(super) fn new(elimination: Elimination, first_step: usize) -> Self {
        Self {
            elimination,
            factors: Factors::default(),
            cells: Vec::new(),
            patterns: Patterns::default(),
            stretches: Vec::new(),
            batches: Vec::new(),
            bundles: Bundles::default(),
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
    pub(crate) fn factors_of(&self, cell: usize) -> Range<usize> {
        let start = cell.checked_sub(1).map_or(0, |previous| self.cells[previous].end);
        start as usize..self.cells[cell].end as usize
    }

    /// The run of one of its factors.
    pub(crate) fn run_of(&self, factor: usize) -> usize {
        self.factors.shape(factor).run as usize
    }
}
