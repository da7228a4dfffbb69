//! The work of one task, ready to be walked through.

use crate::eliminate::SINGLE_ROWS;
use crate::error::Error;
use crate::problem::Problem;

use super::cells::{Cells, Draft};
use super::shape::Shapes;
use super::{Batch, Block, Cell, Chunk, Local, NONE, Pattern, Place, Segment, Stretch, Tile, padded};

/// Rows of so many factors are linearised at once: 64 × 2 rows × 16 numbers are 16 KiB, half of a first-level cache.
const FACTORS_PER_BATCH: usize = 64;

/// What all chunks are built from.
pub(super) struct Context<'a> {
    pub(super) problem: &'a Problem,
    pub(super) blocks: &'a [Block],
    pub(super) places: &'a [Vec<Place>],
    pub(super) cells: &'a Cells,
}

/// Builds the chunk of some cells, whose steps begin at `first_step`.
pub(super) fn build(context: &Context<'_>, order: &[u32], first_step: usize) -> Result<Chunk, Error> {
    let drafts: Vec<&Draft> = order.iter().map(|&draft| &context.cells.drafts[draft as usize]).collect();
    let mut chunk = Chunk { steps: first_step..first_step, ..Chunk::default() };
    let pattern_of = find_patterns(context, &drafts, &mut chunk)?;
    fill(context, &drafts, &pattern_of, &mut chunk)?;
    Ok(chunk)
}

/// Finds the chunk's blocks, patterns and tiles, and each cell's pattern.
fn find_patterns(context: &Context<'_>, drafts: &[&Draft], chunk: &mut Chunk) -> Result<Vec<u32>, Error> {
    let all = &context.cells.blocks;
    // Which of the chunk's blocks a block is; first only whether it is one.
    let mut local_of = vec![NONE; context.blocks.len()];
    let mut pattern_of = Vec::with_capacity(drafts.len());
    let mut patterns: Vec<&[u32]> = Vec::new();
    for draft in drafts {
        let blocks = &all[draft.blocks.clone()];
        if patterns.last() != Some(&blocks) {
            if blocks.len() >= u16::MAX as usize {
                let (count, limit) = (blocks.len(), u16::MAX as usize - 1);
                return Err(Error::TooLarge { what: "variables of one eliminated variable", count, limit });
            }
            patterns.push(blocks);
            blocks.iter().for_each(|&block| local_of[block as usize] = 0);
        }
        pattern_of.push(patterns.len() as u32 - 1);
    }
    for (block, local) in local_of.iter_mut().enumerate().filter(|(_, local)| **local != NONE) {
        *local = chunk.blocks.len() as u32;
        chunk.blocks.push((block as u32, chunk.vector_len));
        chunk.vector_len += padded(context.blocks[block].dof);
    }
    let mut pairs = 0;
    // How often each of the chunk's blocks occurs in a pattern, later: where its occurrences begin.
    let mut start = vec![0; chunk.blocks.len() + 1];
    for blocks in &patterns {
        let begin = chunk.pattern_locals.len();
        let (mut width, mut dense) = (0, 0);
        for &block in *blocks {
            let (dof, local) = (context.blocks[block as usize].dof, local_of[block as usize] as usize);
            let at = chunk.blocks[local].1;
            chunk.pattern_locals.push(Local { dof, padded: padded(dof), at, column: width, dense });
            width += padded(dof);
            dense += dof;
            start[local + 1] += 1;
        }
        chunk.patterns.push(Pattern { locals: begin..chunk.pattern_locals.len(), pairs, width, dense });
        pairs += blocks.len() * (blocks.len() + 1) / 2;
    }
    for i in 1..start.len() {
        start[i] += start[i - 1];
    }
    let mut occurrences = vec![(0u32, 0u32); chunk.pattern_locals.len()];
    let mut next = start.clone();
    for (pattern, blocks) in (0u32..).zip(&patterns) {
        for (i, &block) in (0u32..).zip(*blocks) {
            let next = &mut next[local_of[block as usize] as usize];
            occurrences[*next] = (pattern, i);
            *next += 1;
        }
    }
    // Block column by block column: which blocks meet this one in some pattern, then a tile for each, then who uses it.
    chunk.pair_tiles = vec![0; pairs];
    let mut tile_at = vec![NONE; chunk.blocks.len()];
    let mut met = Vec::new();
    for (a, ends) in start.windows(2).enumerate() {
        let occurrences = &occurrences[ends[0]..ends[1]];
        let a = chunk.blocks[a].0;
        for &(pattern, i) in occurrences {
            for &block in &patterns[pattern as usize][i as usize..] {
                let local = local_of[block as usize];
                if tile_at[local as usize] == NONE {
                    tile_at[local as usize] = 0;
                    met.push(local);
                }
            }
        }
        met.sort_unstable();
        for &local in &met {
            let b = chunk.blocks[local as usize].0;
            tile_at[local as usize] = chunk.tiles_len as u32;
            chunk.tiles.push(Tile { a, b, at: chunk.tiles_len });
            chunk.tiles_len += context.blocks[a as usize].dof * padded(context.blocks[b as usize].dof);
        }
        for &(pattern, i) in occurrences {
            let (blocks, first) = (patterns[pattern as usize], chunk.patterns[pattern as usize].pairs);
            for j in i as usize..blocks.len() {
                let local = local_of[blocks[j] as usize];
                chunk.pair_tiles[first + j * (j + 1) / 2 + i as usize] = tile_at[local as usize];
            }
        }
        met.drain(..).for_each(|local| tile_at[local as usize] = NONE);
    }
    Ok(pattern_of)
}

/// Lists the chunk's cells and factors, and cuts them into batches.
fn fill(
    context: &Context<'_>,
    drafts: &[&Draft],
    pattern_of: &[u32],
    chunk: &mut Chunk,
) -> Result<(), Error> {
    let count = drafts.iter().map(|draft| draft.entries.len()).sum();
    chunk.factors.reserve(count);
    chunk.shape_of.reserve(count);
    chunk.locals.reserve(count);
    chunk.cells.reserve(drafts.len());
    let mut shapes = Shapes::new(context.problem, context.blocks, context.places);
    let (mut batch, mut batch_start, mut rows) = (Batch { stretches: 0..0, cells: 0..0 }, 0, 0);
    for (c, (draft, &pattern)) in drafts.iter().zip(pattern_of).enumerate() {
        let blocks = &context.cells.blocks[draft.blocks.clone()];
        if chunk.factors.len() + draft.entries.len() > batch_start + FACTORS_PER_BATCH
            && !batch.cells.is_empty()
        {
            chunk.batches.push(batch);
            batch = Batch { stretches: chunk.stretches.len()..chunk.stretches.len(), cells: c..c };
            batch_start = chunk.factors.len();
            chunk.rows_len = chunk.rows_len.max(rows);
            rows = 0;
        }
        let mut single = draft.entries.len() == blocks.len();
        for &entry in &context.cells.entries[draft.entries.clone()] {
            let number = shapes.add(entry, draft, blocks, &mut chunk.locals)?;
            let shape = &shapes.shapes[number as usize];
            let i = chunk.factors.len();
            chunk.factors.push(entry.factor);
            chunk.shape_of.push(number);
            rows += shape.rows * shape.stride;
            single &=
                shape.rows == SINGLE_ROWS && matches!(shape.segments[..], [Segment { whole: true, .. }]);
            match chunk.stretches[batch.stretches.clone()].last() {
                Some(last) if (last.run, last.own) == (entry.run, shape.own) => {
                    chunk.stretches[batch.stretches.end - 1].end = i + 1;
                }
                _ => {
                    chunk.stretches.push(Stretch { run: entry.run, own: shape.own, start: i, end: i + 1 });
                    batch.stretches.end += 1;
                }
            }
        }
        batch.cells.end = c + 1;
        let p = draft.dof as usize;
        chunk.cells.push(Cell {
            pattern,
            dof: draft.dof,
            single,
            store: draft.store,
            slot: draft.slot,
            end: chunk.factors.len() as u32,
            stash: chunk.stash_len,
            step: chunk.steps.end,
        });
        if p > 0 {
            chunk.stash_len += crate::eliminate::stash_len(p, chunk.patterns[pattern as usize].dense);
            chunk.steps.end += p;
        }
    }
    if !batch.cells.is_empty() {
        chunk.batches.push(batch);
        chunk.rows_len = chunk.rows_len.max(rows);
    }
    chunk.shapes = shapes.shapes;
    Ok(())
}
