//! The work of one thread: landmark blocks with their factors, and their patterns, batches and
//! tiles.

use std::ops::Range;

use super::elimination::Elimination;
use super::shape::Shape;
use super::tile::Tile;

/// A column block of a pattern.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PatternBlock {
    pub(crate) dof: usize,
    pub(crate) padded: usize,
    /// Offset in the task's vectors.
    pub(crate) vector_offset: usize,
    /// Offset in a padded row over the pattern's blocks.
    pub(crate) padded_offset: usize,
    /// Offset in a row without padding.
    pub(crate) packed_offset: usize,
}

impl PatternBlock {
    /// Its degrees of freedom: the constant `D` unless that is 0.
    #[inline(always)]
    pub(crate) fn dof_or<const D: usize>(&self) -> usize {
        if D > 0 { D } else { self.dof }
    }
}

/// Sorted column blocks that some landmark blocks share.
#[derive(Clone, Debug)]
pub(crate) struct Pattern {
    /// Its [`PatternBlock`]s.
    pub(crate) blocks: Range<usize>,
    /// Offset of its tile offsets, of which that of the pair i ≤ j is at [`pair`].
    pub(crate) pairs: usize,
    /// Sum of `padded` over its blocks.
    pub(crate) padded_width: usize,
    /// Sum of `dof` over its blocks.
    pub(crate) packed_width: usize,
    /// Degrees of freedom of every block; 0 if they differ.
    pub(crate) dof: usize,
}

/// Index of the pair i ≤ j among those of a pattern of `len` blocks: those of block 0 with itself
/// and the later ones, then those of block 1. Tiles lie in memory in this order, so that a product
/// over a pattern reads and writes them one after another.
#[inline(always)]
pub(crate) fn pair(len: usize, i: usize, j: usize) -> usize {
    i * (2 * len - i + 1) / 2 + j - i
}

/// Rows of each factor of a [`single`](LandmarkBlock::single) landmark block.
pub(crate) const SINGLE_ROWS: usize = 2;

/// An eliminated variable with its factors, or factors without one (`dof` 0).
#[derive(Clone, Copy, Debug)]
pub(crate) struct LandmarkBlock {
    pub(crate) pattern: u32,
    /// Degrees of freedom of the eliminated variable; 0 if there is none.
    pub(crate) dof: u32,
    /// The landmark is a point, and each factor has [`SINGLE_ROWS`] rows and one whole column
    /// block, which no other factor of the point has.
    pub(crate) single: bool,
    pub(crate) store: u32,
    pub(crate) slot: u32,
    /// End of its factors in the task's list.
    pub(crate) end: u32,
    /// Offset of its stash in the task's stash.
    pub(crate) stash: usize,
    /// Offset of its step in the step of the whole problem.
    pub(crate) step: usize,
}

/// A range of factors of one group, with the landmark at one position.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FactorRange {
    pub(crate) group: u16,
    /// Position of the eliminated variable among the factors' variables, or [`NO_LANDMARK`].
    pub(crate) landmark_position: u8,
    pub(crate) start: usize,
    pub(crate) end: usize,
}

/// Landmark blocks that are linearised together.
#[derive(Clone, Debug, Default)]
pub(crate) struct Batch {
    pub(crate) factor_ranges: Range<usize>,
    pub(crate) landmarks: Range<usize>,
    pub(crate) rank_updates: Range<usize>,
}

/// A rank-k update of C: the sum of JᵀJ over the rows of factors in a batch that have the same
/// shape and column blocks. Factors of [`single`](LandmarkBlock::single) landmark blocks are in
/// none.
#[derive(Clone, Debug)]
pub(crate) struct RankUpdate {
    pub(crate) shape: u16,
    /// Offset in the task's list of targets: for each segment of the shape the offset of its block
    /// in the task's vectors, then the tile of each pair of segments, that of i ≤ j at `j (j + 1) /
    /// 2 + i`.
    pub(crate) targets: usize,
    /// Range in the task's list of row offsets in the batch.
    pub(crate) rows: Range<usize>,
}

/// The factors of a task, ordered by landmark block.
#[derive(Clone, Debug, Default)]
pub(crate) struct Factors {
    /// Index of each in its group.
    pub(crate) indices: Vec<u32>,
    /// Index of each one's shape in `shapes`.
    pub(crate) shape_of: Vec<u16>,
    pub(crate) shapes: Vec<Shape>,
    /// For each segment of each factor: index of its block in the pattern.
    pub(crate) block_indices: Vec<u16>,
}

impl Factors {
    #[inline(always)]
    pub(crate) fn shape(&self, factor: usize) -> &Shape {
        &self.shapes[self.shape_of[factor] as usize]
    }
}

/// The patterns of a task's landmark blocks.
#[derive(Clone, Debug, Default)]
pub(crate) struct Patterns {
    pub(crate) list: Vec<Pattern>,
    /// The blocks of each.
    pub(crate) blocks: Vec<PatternBlock>,
    /// Tile offsets, see [`Pattern::pairs`]; [`NONE`](super::block::NONE) if there is no tile.
    pub(crate) pair_tiles: Vec<u32>,
}

impl Patterns {
    #[inline(always)]
    pub(crate) fn of(&self, landmark: &LandmarkBlock) -> &Pattern {
        &self.list[landmark.pattern as usize]
    }

    #[inline(always)]
    pub(crate) fn blocks_of(&self, landmark: &LandmarkBlock) -> &[PatternBlock] {
        &self.blocks[self.of(landmark).blocks.clone()]
    }
}

/// The rank-k updates of a task's batches.
#[derive(Clone, Debug, Default)]
pub(crate) struct RankUpdates {
    pub(crate) list: Vec<RankUpdate>,
    /// See [`RankUpdate::targets`].
    pub(crate) targets: Vec<u32>,
    /// See [`RankUpdate::rows`].
    pub(crate) rows: Vec<u32>,
}

/// The work of one thread.
#[derive(Clone, Debug)]
pub(crate) struct Task {
    pub(crate) elimination: Elimination,
    pub(crate) factors: Factors,
    pub(crate) landmarks: Vec<LandmarkBlock>,
    pub(crate) patterns: Patterns,
    pub(crate) factor_ranges: Vec<FactorRange>,
    pub(crate) batches: Vec<Batch>,
    pub(crate) rank_updates: RankUpdates,
    /// Its column blocks in order, and their offsets in its vectors.
    pub(crate) blocks: Vec<(u32, usize)>,
    pub(crate) vector_len: usize,
    /// Its tiles, in order.
    pub(crate) tiles: Vec<Tile>,
    pub(crate) tiles_len: usize,
    pub(crate) stash_len: usize,
    /// Range of its tiles and its stash in the memory of all tasks.
    pub(crate) memory: Range<usize>,
    /// Range of its landmarks in the step of the whole problem.
    pub(crate) steps: Range<usize>,
    /// Length of the rows of its longest batch.
    pub(crate) rows_len: usize,
}

impl Task {
    /// An empty task. `first_step` is the offset of its landmarks' steps.
    pub(super) fn new(elimination: Elimination, first_step: usize) -> Self {
        Self {
            elimination,
            factors: Factors::default(),
            landmarks: Vec::new(),
            patterns: Patterns::default(),
            factor_ranges: Vec::new(),
            batches: Vec::new(),
            rank_updates: RankUpdates::default(),
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

    /// Range of the factors of one of its landmark blocks.
    pub(crate) fn factors_of(&self, landmark: usize) -> Range<usize> {
        let start = landmark.checked_sub(1).map_or(0, |previous| self.landmarks[previous].end);
        start as usize..self.landmarks[landmark].end as usize
    }

    /// Group of one of its factors.
    pub(crate) fn group_of(&self, factor: usize) -> usize {
        self.factors.shape(factor).group as usize
    }
}
