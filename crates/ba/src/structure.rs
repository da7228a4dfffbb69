//! What is known of a problem before its numbers: blocks of the reduced system, cells to eliminate, chunks of work.
//!
//! * A **block** is a stretch of columns of the reduced system: one kept variable, or several that never occur apart beside an
//!   eliminated one (a camera's own intrinsics and its pose), which then cost one product instead of four.
//! * A **cell** is one eliminated variable with all its factors, or a bunch of factors that join the same kept variables only.
//!   Its **pattern** is the sorted list of distinct blocks that it touches: products are taken over these, not over factors.
//! * A **chunk** is a stretch of cells, sorted by their blocks, that one task works through. It sums into tiles of its own,
//!   for the blocks that it touches only, and the chunks' sums are added in order. Their number depends on the problem
//!   alone, and so does every rounding error.
//!
//! A partly fixed variable keeps its full width up to here, with columns of zeros, so that blocks stay uniform; the columns are
//! left out when the reduced system is put together.

use crate::error::Error;
use crate::problem::Problem;
use crate::variable::{Meta, Order, Role};

/// Enough work for a task: some 100 µs.
const FACTORS_PER_CHUNK: usize = 4096;
/// More tasks than cores of any machine we know would only cost memory.
const MAX_CHUNKS: usize = 64;
/// Rows of so many factors are linearised at once: 64 × 2 rows × 16 numbers are 16 KiB, half of a first-level cache.
const FACTORS_PER_BATCH: usize = 64;
/// Factors that join the same kept variables are bunched in cells of at most so many.
const FACTORS_PER_KEPT_CELL: usize = 1024;
/// Variables are not merged into blocks wider than this.
const MAX_MERGED_DOF: usize = 24;

/// "There is none."
pub(crate) const NONE: u32 = u32::MAX;

/// Numbers per row of storage: a multiple of the vector width that all instruction sets share.
pub(crate) fn padded(dof: usize) -> usize {
    dof.next_multiple_of(4)
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
}

/// Columns of one block in a factor's rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Segment {
    /// First column in the rows.
    pub(crate) column: usize,
    pub(crate) dof: usize,
    /// First column in the block.
    pub(crate) offset: usize,
    /// Whether it is the whole block.
    pub(crate) whole: bool,
}

/// How the rows of a factor fall into blocks: few of these serve all factors.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Shape {
    pub(crate) run: u16,
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
}

/// The blocks that a cell touches.
#[derive(Clone, Debug)]
pub(crate) struct Pattern {
    /// First and last of its [`Local`]s.
    pub(crate) locals: std::ops::Range<usize>,
    /// Where its offsets of tiles begin: of the pair i ≤ j at `j (j + 1) / 2 + i`.
    pub(crate) pairs: usize,
    /// Sum of `padded` over its blocks.
    pub(crate) width: usize,
}

/// An eliminated variable with its factors, or factors without one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cell {
    pub(crate) pattern: u32,
    /// Degrees of freedom of the eliminated variable; 0 where there is none.
    pub(crate) dof: u32,
    pub(crate) store: u32,
    pub(crate) slot: u32,
    /// Its factors end here in the chunk's list.
    pub(crate) end: u32,
    /// Where its numbers begin in the chunk's stash.
    pub(crate) stash: usize,
    /// Where its step begins in the step of the whole problem.
    pub(crate) step: usize,
}

/// A stretch of factors of one run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stretch {
    pub(crate) run: u16,
    pub(crate) start: usize,
    pub(crate) end: usize,
}

/// A product of two blocks, a ≤ b: `dof(a)` columns of `padded(dof(b))` numbers, beginning at `at`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tile {
    pub(crate) a: u32,
    pub(crate) b: u32,
    pub(crate) at: usize,
}

/// What is linearised at once.
#[derive(Clone, Debug)]
pub(crate) struct Batch {
    pub(crate) stretches: std::ops::Range<usize>,
    pub(crate) cells: std::ops::Range<usize>,
}

/// The work of one task.
#[derive(Clone, Debug, Default)]
pub(crate) struct Chunk {
    /// Number of each factor in its run.
    pub(crate) factors: Vec<u32>,
    pub(crate) shapes: Vec<u16>,
    /// For each factor, for each segment of its shape: which of the pattern's blocks.
    pub(crate) locals: Vec<u16>,
    pub(crate) cells: Vec<Cell>,
    pub(crate) stretches: Vec<Stretch>,
    pub(crate) batches: Vec<Batch>,
    pub(crate) patterns: Vec<Pattern>,
    pub(crate) pattern_locals: Vec<Local>,
    pub(crate) pair_tiles: Vec<u32>,
    /// The blocks that it touches, in order, and where their numbers begin in its vectors.
    pub(crate) blocks: Vec<(u32, usize)>,
    pub(crate) vector_len: usize,
    /// The tiles that it touches, in order.
    pub(crate) tiles: Vec<Tile>,
    pub(crate) tiles_len: usize,
    pub(crate) stash_len: usize,
    /// Its eliminated variables' part of the step.
    pub(crate) steps: std::ops::Range<usize>,
    pub(crate) rows_len: usize,
}

impl Chunk {
    /// The factors of one of its cells.
    pub(crate) fn factors_of(&self, cell: usize) -> std::ops::Range<usize> {
        let start = cell.checked_sub(1).map_or(0, |previous| self.cells[previous].end);
        start as usize..self.cells[cell].end as usize
    }
}

/// The structure of a problem.
pub(crate) struct Structure {
    pub(crate) blocks: Vec<Block>,
    /// Length of vectors over all blocks.
    pub(crate) kept_len: usize,
    /// Columns of the reduced system.
    pub(crate) columns: usize,
    pub(crate) shapes: Vec<Shape>,
    pub(crate) chunks: Vec<Chunk>,
    /// Per store, per variable: where its step is, or `variable::FIXED`.
    pub(crate) step_at: Vec<Vec<u32>>,
    pub(crate) step_len: usize,
    pub(crate) places: Vec<Vec<Place>>,
}

/// Whether declared eliminations are done or ignored (for solvers that see the whole Jacobian).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Elimination {
    Do,
    Ignore,
}

/// A factor on its way into a chunk.
#[derive(Clone, Copy)]
struct Entry {
    run: u16,
    factor: u32,
}

/// A cell on its way into a chunk.
struct Draft {
    key: [u32; 3],
    blocks: std::ops::Range<usize>,
    entries: std::ops::Range<usize>,
    dof: u32,
    store: u32,
    slot: u32,
}

struct Builder<'a> {
    problem: &'a Problem,
    elimination: Elimination,
    blocks: Vec<Block>,
    places: Vec<Vec<Place>>,
    shapes: Vec<Shape>,
    /// To make the next shape in.
    shape: Shape,
    entries: Vec<Entry>,
    cell_blocks: Vec<u32>,
}

impl Structure {
    pub(crate) fn new(problem: &Problem, elimination: Elimination) -> Result<Self, Error> {
        let limit = u32::MAX as usize - 1;
        let numbers: usize = problem.runs.iter().map(|run| run.len()).sum();
        if numbers > limit {
            return Err(Error::TooLarge { what: "factors", count: numbers, limit });
        }
        let numbers = problem.values.stores.iter().map(|store| store.len() * store.dof()).sum();
        if numbers > limit / 2 {
            return Err(Error::TooLarge { what: "degrees of freedom", count: numbers, limit: limit / 2 });
        }
        if problem.runs.len() > u16::MAX as usize {
            let (count, limit) = (problem.runs.len(), u16::MAX as usize);
            return Err(Error::TooLarge { what: "factor types", count, limit });
        }
        let mut builder = Builder {
            problem,
            elimination,
            blocks: Vec::new(),
            places: Vec::new(),
            shapes: Vec::new(),
            shape: Shape::default(),
            entries: Vec::new(),
            cell_blocks: Vec::new(),
        };
        builder.place_variables()?;
        let mut drafts = builder.draft_cells();
        // Only neighbours with equal patterns gain from the order; beyond three blocks it makes no difference.
        drafts.sort_by_key(|draft| (draft.dof == 0, draft.key));
        let kept_len: usize = builder.blocks.iter().map(|block| padded(block.dof)).sum();
        let mut step_len = kept_len;
        let mut step_at: Vec<Vec<u32>> = (builder.places.iter())
            .map(|places| {
                let at = |place: &Place| match place.block {
                    NONE => crate::variable::FIXED,
                    block => (builder.blocks[block as usize].at as u32) + place.offset,
                };
                places.iter().map(at).collect()
            })
            .collect();
        let mut chunks = Vec::new();
        let mut local_of_block = vec![NONE; builder.blocks.len()];
        let per_chunk = builder.entries.len().div_ceil(num_chunks(builder.entries.len()));
        let mut rest = &drafts[..];
        while !rest.is_empty() {
            let mut count = 0;
            let len = rest.iter().take_while(|draft| {
                let fits = count < per_chunk;
                count += draft.entries.len();
                fits
            });
            let (these, others) = rest.split_at(len.count());
            rest = others;
            let chunk = builder.build_chunk(these, step_len, &mut local_of_block)?;
            for cell in chunk.cells.iter().filter(|cell| cell.dof > 0) {
                step_at[cell.store as usize][cell.slot as usize] = cell.step as u32;
            }
            step_len = chunk.steps.end;
            chunks.push(chunk);
        }
        let columns = builder.blocks.iter().map(Block::num_free).sum();
        let Builder { blocks, places, shapes, .. } = builder;
        Ok(Self { blocks, kept_len, columns, shapes, chunks, step_at, step_len, places })
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

impl Builder<'_> {
    fn meta(&self, store: u16, slot: u32) -> Meta {
        self.problem.metas[store as usize][slot as usize]
    }

    fn is_eliminated(&self, meta: Meta) -> bool {
        meta.role == Role::Eliminated && self.elimination == Elimination::Do
    }

    /// Decides blocks and their order.
    fn place_variables(&mut self) -> Result<(), Error> {
        let next = self.inseparable()?;
        let metas = &self.problem.metas;
        let mut has_previous: Vec<Vec<bool>> = metas.iter().map(|metas| vec![false; metas.len()]).collect();
        for &(store, slot) in next.iter().flatten().flatten() {
            has_previous[store as usize][slot as usize] = true;
        }
        // A chain of inseparable variables becomes one block; it stands where the earliest of them wants to.
        let mut chains: Vec<(Order, Vec<(u16, u32)>)> = Vec::new();
        for store in 0..metas.len() as u16 {
            for slot in 0..metas[store as usize].len() as u32 {
                let meta = self.meta(store, slot);
                if meta.free == 0 || self.is_eliminated(meta) || has_previous[store as usize][slot as usize] {
                    continue;
                }
                let dof = |store: u16| self.problem.values.stores[store as usize].dof();
                let (mut chain, mut order, mut width) = (vec![(store, slot)], order_of(meta), dof(store));
                while let Some((store, slot)) = chain.last().and_then(|&(s, i)| next[s as usize][i as usize])
                {
                    if width + dof(store) > MAX_MERGED_DOF {
                        chains.push((order, std::mem::take(&mut chain)));
                        (order, width) = (Order::Shared, 0);
                    }
                    order = order.min(order_of(self.meta(store, slot)));
                    width += dof(store);
                    chain.push((store, slot));
                }
                chains.push((order, chain));
            }
        }
        chains.sort_by_key(|(order, _)| *order);
        let nowhere = Place { block: NONE, offset: 0 };
        self.places = metas.iter().map(|metas| vec![nowhere; metas.len()]).collect();
        let (mut at, mut reduced) = (0, 0);
        for (_, chain) in chains {
            let mut block = Block { dof: 0, at, free: 0, reduced };
            for (store, slot) in chain {
                let place = Place { block: self.blocks.len() as u32, offset: block.dof as u32 };
                self.places[store as usize][slot as usize] = place;
                block.free |= self.meta(store, slot).free << block.dof;
                block.dof += self.problem.values.stores[store as usize].dof();
            }
            at += padded(block.dof);
            reduced += block.num_free();
            self.blocks.push(block);
        }
        Ok(())
    }

    /// For each kept variable, the one that always stands next to it, in factors with an eliminated variable: both occur
    /// nowhere there without the other.
    #[allow(clippy::type_complexity)]
    fn inseparable(&self) -> Result<Vec<Vec<Option<(u16, u32)>>>, Error> {
        #[derive(Clone, Copy, PartialEq)]
        enum Link {
            Unseen,
            To(Option<(u16, u32)>),
            Differs,
        }
        fn meet(link: &mut Link, to: Option<(u16, u32)>) {
            *link = match *link {
                Link::Unseen => Link::To(to),
                Link::To(old) if old == to => *link,
                _ => Link::Differs,
            };
        }
        let metas = &self.problem.metas;
        let mut after: Vec<Vec<Link>> = metas.iter().map(|metas| vec![Link::Unseen; metas.len()]).collect();
        let mut before = after.clone();
        let mut kept = Vec::new();
        for run in &self.problem.runs {
            for factor in 0..run.len() {
                let mut eliminated = None;
                kept.clear();
                for (position, (&store, &slot)) in run.stores().iter().zip(run.slots(factor)).enumerate() {
                    let meta = self.meta(store, slot);
                    if meta.free == 0 {
                        continue;
                    }
                    if self.is_eliminated(meta) {
                        if let Some(first) = eliminated.replace(position) {
                            let factor_type = run.factor_type();
                            let second = position;
                            return Err(Error::TwoEliminated {
                                factor: factor_type,
                                index: factor,
                                first,
                                second,
                            });
                        }
                    } else {
                        kept.push((position, (store, slot)));
                    }
                }
                if eliminated.is_none() {
                    continue;
                }
                for (i, &(position, (store, slot))) in kept.iter().enumerate() {
                    // Next to it in the rows, with nothing fixed or eliminated between.
                    let next = kept.get(i + 1).filter(|next| next.0 == position + 1).map(|next| next.1);
                    let previous =
                        i.checked_sub(1).map(|i| kept[i]).filter(|previous| previous.0 + 1 == position);
                    meet(&mut after[store as usize][slot as usize], next);
                    meet(&mut before[store as usize][slot as usize], previous.map(|previous| previous.1));
                }
            }
        }
        let mut next: Vec<Vec<Option<(u16, u32)>>> =
            after.iter().map(|links| vec![None; links.len()]).collect();
        for store in 0..metas.len() {
            for slot in 0..metas[store].len() {
                let Link::To(Some((s, i))) = after[store][slot] else { continue };
                if before[s as usize][i as usize] == Link::To(Some((store as u16, slot as u32))) {
                    next[store][slot] = Some((s, i));
                }
            }
        }
        Ok(next)
    }

    /// Collects the factors of every cell, and its blocks.
    fn draft_cells(&mut self) -> Vec<Draft> {
        let problem = self.problem;
        let mut first = Vec::with_capacity(problem.metas.len());
        let mut total = 0;
        for metas in &problem.metas {
            first.push(total);
            total += metas.len();
        }
        // Which eliminated variable a factor has, counted over all stores; `total` for none.
        let owner = |builder: &Self, run: usize, factor: usize| {
            let run = &problem.runs[run];
            let free_eliminated = |(&store, &slot): (&u16, &u32)| {
                let meta = builder.meta(store, slot);
                (meta.free != 0 && builder.is_eliminated(meta)).then(|| first[store as usize] + slot as usize)
            };
            run.stores().iter().zip(run.slots(factor)).find_map(free_eliminated).unwrap_or(total)
        };
        let mut start = vec![0usize; total + 2];
        for (r, run) in problem.runs.iter().enumerate() {
            for factor in 0..run.len() {
                start[owner(self, r, factor) + 1] += 1;
            }
        }
        for i in 0..=total {
            start[i + 1] += start[i];
        }
        let mut fill = start.clone();
        self.entries = vec![Entry { run: 0, factor: 0 }; start[total + 1]];
        for (r, run) in problem.runs.iter().enumerate() {
            for factor in 0..run.len() {
                let at = &mut fill[owner(self, r, factor)];
                self.entries[*at] = Entry { run: r as u16, factor: factor as u32 };
                *at += 1;
            }
        }
        let mut drafts = Vec::new();
        for (store, metas) in problem.metas.iter().enumerate() {
            for slot in 0..metas.len() {
                let entries = start[first[store] + slot]..start[first[store] + slot + 1];
                if !entries.is_empty() {
                    let dof = problem.values.stores[store].dof() as u32;
                    let (key, blocks) = self.collect_blocks(entries.clone());
                    drafts.push(Draft { key, blocks, entries, dof, store: store as u32, slot: slot as u32 });
                }
            }
        }
        self.draft_kept_cells(start[total]..start[total + 1], &mut drafts);
        drafts
    }

    /// Bunches the factors without an eliminated variable by the blocks that they join.
    fn draft_kept_cells(&mut self, entries: std::ops::Range<usize>, drafts: &mut Vec<Draft>) {
        let mut singles: Vec<_> = entries
            .clone()
            .map(|i| {
                let (key, blocks) = self.collect_blocks(i..i + 1);
                (key, blocks, self.entries[i])
            })
            .collect();
        singles.sort_by(|a, b| {
            let blocks = self.cell_blocks[a.1.clone()].cmp(&self.cell_blocks[b.1.clone()]);
            blocks.then((a.2.run, a.2.factor).cmp(&(b.2.run, b.2.factor)))
        });
        for (i, single) in entries.clone().zip(&singles) {
            self.entries[i] = single.2;
        }
        let mut at = 0;
        while at < singles.len() {
            let blocks = &self.cell_blocks[singles[at].1.clone()];
            let same = |other: &&([u32; 3], std::ops::Range<usize>, Entry)| {
                self.cell_blocks[other.1.clone()] == *blocks
            };
            let len = singles[at..].iter().take(FACTORS_PER_KEPT_CELL).take_while(same).count();
            drafts.push(Draft {
                key: singles[at].0,
                blocks: singles[at].1.clone(),
                entries: entries.start + at..entries.start + at + len,
                dof: 0,
                store: 0,
                slot: 0,
            });
            at += len;
        }
    }

    /// The sorted distinct blocks of some factors, appended to `cell_blocks`; and the first three of them.
    fn collect_blocks(&mut self, entries: std::ops::Range<usize>) -> ([u32; 3], std::ops::Range<usize>) {
        let begin = self.cell_blocks.len();
        for i in entries {
            let Entry { run, factor } = self.entries[i];
            let run = &self.problem.runs[run as usize];
            for (&store, &slot) in run.stores().iter().zip(run.slots(factor as usize)) {
                let block = self.places[store as usize][slot as usize].block;
                if block != NONE {
                    self.cell_blocks.push(block);
                }
            }
        }
        self.cell_blocks[begin..].sort_unstable();
        let mut end = begin;
        for i in begin..self.cell_blocks.len() {
            if end == begin || self.cell_blocks[i] != self.cell_blocks[end - 1] {
                self.cell_blocks[end] = self.cell_blocks[i];
                end += 1;
            }
        }
        self.cell_blocks.truncate(end);
        let key = std::array::from_fn(|i| self.cell_blocks[begin..].get(i).map_or(0, |&block| block + 1));
        (key, begin..end)
    }

    fn build_chunk(
        &mut self,
        drafts: &[Draft],
        first_step: usize,
        local_of_block: &mut [u32],
    ) -> Result<Chunk, Error> {
        let mut chunk = Chunk { steps: first_step..first_step, ..Chunk::default() };
        let mut touched: Vec<u32> =
            drafts.iter().flat_map(|draft| self.cell_blocks[draft.blocks.clone()].iter().copied()).collect();
        touched.sort_unstable();
        touched.dedup();
        for (local, &block) in touched.iter().enumerate() {
            local_of_block[block as usize] = local as u32;
            chunk.blocks.push((block, chunk.vector_len));
            chunk.vector_len += padded(self.blocks[block as usize].dof);
        }
        self.place_tiles(drafts, local_of_block, &mut chunk);
        let tile_of = |a: u32, b: u32| {
            let tile = chunk.tiles.binary_search_by_key(&(a, b), |tile| (tile.a, tile.b));
            chunk.tiles[tile.expect("all pairs of all cells have tiles")].at as u32
        };
        let mut previous: &[u32] = &[];
        for draft in drafts {
            let blocks = &self.cell_blocks[draft.blocks.clone()];
            if blocks.len() >= u16::MAX as usize {
                let (count, limit) = (blocks.len(), u16::MAX as usize - 1);
                return Err(Error::TooLarge { what: "variables of one eliminated variable", count, limit });
            }
            if chunk.patterns.is_empty() || blocks != previous {
                let begin = chunk.pattern_locals.len();
                let mut width = 0;
                for &block in blocks {
                    let dof = self.blocks[block as usize].dof;
                    let at = chunk.blocks[local_of_block[block as usize] as usize].1;
                    chunk.pattern_locals.push(Local { dof, padded: padded(dof), at, column: width });
                    width += padded(dof);
                }
                let locals = begin..chunk.pattern_locals.len();
                chunk.patterns.push(Pattern { locals, pairs: chunk.pair_tiles.len(), width });
                for (j, &b) in blocks.iter().enumerate() {
                    chunk.pair_tiles.extend(blocks[..=j].iter().map(|&a| tile_of(a, b)));
                }
                previous = blocks;
            }
        }
        let mut pattern = 0;
        let mut batch_start = 0;
        let mut batch_cells = 0..0;
        let mut batch_stretches = 0..0;
        let mut rows = 0;
        previous = &[];
        for (c, draft) in drafts.iter().enumerate() {
            let blocks = &self.cell_blocks[draft.blocks.clone()];
            if c > 0 && blocks != previous {
                pattern += 1;
            }
            previous = blocks;
            if chunk.factors.len() + draft.entries.len() > batch_start + FACTORS_PER_BATCH
                && !batch_cells.is_empty()
            {
                chunk.batches.push(Batch { stretches: batch_stretches.clone(), cells: batch_cells.clone() });
                batch_start = chunk.factors.len();
                batch_cells = c..c;
                batch_stretches = chunk.stretches.len()..chunk.stretches.len();
                chunk.rows_len = chunk.rows_len.max(rows);
                rows = 0;
            }
            for entry in &self.entries[draft.entries.clone()] {
                make_shape(self.problem, &self.blocks, &self.places, *entry, draft, &mut self.shape);
                let shape = number_of(&self.shape, &mut self.shapes)?;
                let blocks = &self.cell_blocks[draft.blocks.clone()];
                push_locals(self.problem, &self.places, *entry, blocks, &mut chunk.locals);
                let i = chunk.factors.len();
                chunk.factors.push(entry.factor);
                chunk.shapes.push(shape);
                rows += self.shapes[shape as usize].rows * self.shapes[shape as usize].stride;
                match chunk.stretches[batch_stretches.clone()].last() {
                    Some(last) if last.run == entry.run => {
                        chunk.stretches[batch_stretches.end - 1].end = i + 1;
                    }
                    _ => {
                        chunk.stretches.push(Stretch { run: entry.run, start: i, end: i + 1 });
                        batch_stretches.end += 1;
                    }
                }
            }
            batch_cells.end = c + 1;
            let p = draft.dof as usize;
            chunk.cells.push(Cell {
                pattern: pattern as u32,
                dof: draft.dof,
                store: draft.store,
                slot: draft.slot,
                end: chunk.factors.len() as u32,
                stash: chunk.stash_len,
                step: chunk.steps.end,
            });
            if p > 0 {
                chunk.stash_len += crate::eliminate::stash_len(p, chunk.patterns[pattern].width);
                chunk.steps.end += p;
            }
        }
        if !batch_cells.is_empty() {
            chunk.batches.push(Batch { stretches: batch_stretches, cells: batch_cells });
            chunk.rows_len = chunk.rows_len.max(rows);
        }
        Ok(chunk)
    }

    /// Finds the pairs of blocks that some cell joins, and gives each a tile.
    fn place_tiles(&self, drafts: &[Draft], local_of_block: &[u32], chunk: &mut Chunk) {
        let mut above: Vec<Vec<u32>> = vec![Vec::new(); chunk.blocks.len()];
        let mut seen = vec![NONE; chunk.blocks.len()];
        // Column by column, so that one row of marks is enough: which cells a block occurs in.
        let mut cells_of: Vec<Vec<u32>> = vec![Vec::new(); chunk.blocks.len()];
        let mut previous: &[u32] = &[];
        for (c, draft) in drafts.iter().enumerate() {
            let blocks = &self.cell_blocks[draft.blocks.clone()];
            if blocks == previous {
                continue;
            }
            for &block in blocks {
                cells_of[local_of_block[block as usize] as usize].push(c as u32);
            }
            previous = blocks;
        }
        for (a, cells) in cells_of.iter().enumerate() {
            for &cell in cells {
                for &block in &self.cell_blocks[drafts[cell as usize].blocks.clone()] {
                    let b = local_of_block[block as usize] as usize;
                    if b >= a && seen[b] != a as u32 {
                        seen[b] = a as u32;
                        above[a].push(b as u32);
                    }
                }
            }
            above[a].sort_unstable();
        }
        for (a, others) in above.iter().enumerate() {
            let a = chunk.blocks[a].0;
            for &b in others {
                let b = chunk.blocks[b as usize].0;
                chunk.tiles.push(Tile { a, b, at: chunk.tiles_len });
                chunk.tiles_len += self.blocks[a as usize].dof * padded(self.blocks[b as usize].dof);
            }
        }
    }
}

fn order_of(meta: Meta) -> Order {
    match meta.role {
        Role::Kept(order) => order,
        Role::Eliminated => Order::Shared,
    }
}

/// Writes how the rows of a factor fall into blocks.
fn make_shape(
    problem: &Problem,
    blocks: &[Block],
    places: &[Vec<Place>],
    entry: Entry,
    draft: &Draft,
    shape: &mut Shape,
) {
    let run = &problem.runs[entry.run as usize];
    let Shape { segments, held, .. } = shape;
    segments.clear();
    held.clear();
    let (mut eliminated, mut column, mut last_block) = (0, 0, NONE);
    for ((&store, &slot), &dof) in run.stores().iter().zip(run.slots(entry.factor as usize)).zip(run.dofs()) {
        let place = places[store as usize][slot as usize];
        let free = problem.metas[store as usize][slot as usize].free;
        if free != 0 {
            held.extend((0..dof).filter(|i| free >> i & 1 == 0).map(|i| column + i));
        }
        if place.block != NONE {
            let (offset, block_dof) = (place.offset as usize, blocks[place.block as usize].dof);
            match segments.last_mut() {
                Some(last)
                    if last_block == place.block
                        && last.column + last.dof == column
                        && last.offset + last.dof == offset =>
                {
                    last.dof += dof;
                    last.whole = last.dof == block_dof;
                }
                _ => segments.push(Segment { column, dof, offset, whole: dof == block_dof }),
            }
            last_block = place.block;
        } else if draft.dof > 0 && (store as u32, slot) == (draft.store, draft.slot) {
            eliminated = column;
        }
        column += dof;
    }
    (shape.run, shape.rows, shape.stride) = (entry.run, run.rows(), run.stride());
    (shape.residual, shape.eliminated) = (column, eliminated);
}

/// Number of a shape, which joins the others if it is new.
fn number_of(shape: &Shape, shapes: &mut Vec<Shape>) -> Result<u16, Error> {
    // The newest is the likeliest.
    if let Some(found) = shapes.iter().rposition(|other| other == shape) {
        return Ok(found as u16);
    }
    if shapes.len() >= u16::MAX as usize {
        return Err(Error::TooLarge {
            what: "shapes of factors",
            count: shapes.len() + 1,
            limit: u16::MAX as usize,
        });
    }
    shapes.push(shape.clone());
    Ok((shapes.len() - 1) as u16)
}

/// For each segment of a factor, which of the cell's blocks it is.
fn push_locals(
    problem: &Problem,
    places: &[Vec<Place>],
    entry: Entry,
    blocks: &[u32],
    locals: &mut Vec<u16>,
) {
    let run = &problem.runs[entry.run as usize];
    let (mut last, mut last_end) = (NONE, (0, 0));
    let mut column = 0;
    for ((&store, &slot), &dof) in run.stores().iter().zip(run.slots(entry.factor as usize)).zip(run.dofs()) {
        let place = places[store as usize][slot as usize];
        if place.block != NONE {
            let continues = last == place.block && last_end == (column, place.offset as usize);
            if !continues {
                let local =
                    blocks.binary_search(&place.block).expect("the cell lists all its factors' blocks");
                locals.push(local as u16);
            }
            last = place.block;
            last_end = (column + dof, place.offset as usize + dof);
        }
        column += dof;
    }
}

/// The run of a chunk's factor.
pub(crate) fn run_of(chunk: &Chunk, shapes: &[Shape], factor: usize) -> usize {
    shapes[chunk.shapes[factor] as usize].run as usize
}
