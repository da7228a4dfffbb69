//! The work of one task, ready to be walked through.

use crate::error::Error;
use crate::problem::Problem;

use super::block::{Block, NONE};
use super::bundles::Bundler;
use super::cells::{Cells, Draft};
use super::chunk::{Batch, Cell, Chunk, Local, Pattern, Stretch};
use super::elimination::Elimination;
use super::groups::Groups;
use super::place::Look;
use super::shapes::Shapes;
use super::stash::stash_len;
use super::tile::{Tile, padded, tile_len};

/// Rows of so many factors are linearised at once: 96 × 2 rows × 16 numbers are 24 KiB, half of a first-level cache; fewer make
/// products of few cells.
const FACTORS_PER_BATCH: usize = 96;

/// What all chunks are built from.
pub(super) struct Context<'a> {
    pub(super) problem: &'a Problem,
    pub(super) blocks: &'a [Block],
    pub(super) looks: &'a [Look],
    pub(super) cells: &'a Cells<'a>,
    pub(super) elimination: Elimination,
}

/// Builds the chunk of some cells, whose steps begin at `first_step`.
pub(super) fn build(context: &Context<'_>, drafts: &[Draft], first_step: usize) -> Result<Chunk, Error> {
    let mut chunk = Chunk::new(context.elimination, first_step);
    let Groups { drafts, groups } = Groups::new(context.cells, drafts, context.elimination);
    find_patterns(context, &drafts, &groups, &mut chunk)?;
    fill(context, &drafts, &groups, &mut chunk)?;
    Ok(chunk)
}

/// Finds the chunk's blocks, patterns and tiles.
fn find_patterns(
    context: &Context<'_>,
    drafts: &[Draft],
    groups: &[(&[u32], usize)],
    chunk: &mut Chunk,
) -> Result<(), Error> {
    // Which of the chunk's blocks a block is; first only whether it is one.
    let mut local_of = vec![NONE; context.blocks.len()];
    for (blocks, _) in groups {
        if blocks.len() >= u16::MAX as usize {
            let (count, limit) = (blocks.len(), u16::MAX as usize - 1);
            return Err(Error::TooLarge { what: "variables of one eliminated variable", count, limit });
        }
        blocks.iter().for_each(|&block| local_of[block as usize] = 0);
    }
    for (block, local) in local_of.iter_mut().enumerate().filter(|(_, local)| **local != NONE) {
        *local = chunk.blocks.len() as u32;
        chunk.blocks.push((block as u32, chunk.vector_len));
        chunk.vector_len += padded(context.blocks[block].dof);
    }
    let direct = direct_pairs(context, drafts);
    let mut pairs = 0;
    // How often each of the chunk's blocks occurs in a pattern, later: where its occurrences begin.
    let mut start = vec![0; chunk.blocks.len() + 1];
    for &(blocks, _) in groups {
        let begin = chunk.pattern_locals.len();
        let (mut width, mut dense) = (0, 0);
        let first = blocks.first().map_or(0, |&block| context.blocks[block as usize].dof);
        for &block in blocks {
            let (dof, local) = (context.blocks[block as usize].dof, local_of[block as usize] as usize);
            let at = chunk.blocks[local].1;
            chunk.pattern_locals.push(Local { dof, padded: padded(dof), at, column: width, dense });
            width += padded(dof);
            dense += dof;
            start[local + 1] += 1;
        }
        let locals = begin..chunk.pattern_locals.len();
        let same = chunk.pattern_locals[locals.clone()].iter().all(|local| local.dof == first);
        chunk.patterns.push(Pattern { locals, pairs, width, dense, dof: if same { first } else { 0 } });
        pairs += blocks.len() * (blocks.len() + 1) / 2;
    }
    for i in 1..start.len() {
        start[i] += start[i - 1];
    }
    let mut occurrences = vec![(0u32, 0u32); chunk.pattern_locals.len()];
    let mut next = start.clone();
    for (pattern, &(blocks, _)) in (0u32..).zip(groups) {
        for (i, &block) in (0u32..).zip(blocks) {
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
            for &block in &groups[pattern as usize].0[i as usize..] {
                let local = local_of[block as usize];
                let wanted = direct
                    .as_ref()
                    .is_none_or(|direct| block == a || direct.binary_search(&(a, block)).is_ok());
                if wanted && tile_at[local as usize] == NONE {
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
            chunk.tiles_len += tile_len(context.blocks[a as usize].dof, context.blocks[b as usize].dof);
        }
        for &(pattern, i) in occurrences {
            let (blocks, first) = (groups[pattern as usize].0, chunk.patterns[pattern as usize].pairs);
            for j in i as usize..blocks.len() {
                let local = local_of[blocks[j] as usize];
                chunk.pair_tiles[first + j * (j + 1) / 2 + i as usize] = tile_at[local as usize];
            }
        }
        met.drain(..).for_each(|local| tile_at[local as usize] = NONE);
    }
    Ok(())
}

/// Where only these get tiles: the pairs of different blocks that some factor joins, sorted.
fn direct_pairs(context: &Context<'_>, drafts: &[Draft]) -> Option<Vec<(u32, u32)>> {
    if context.elimination != Elimination::Implicit {
        return None;
    }
    let mut pairs = Vec::new();
    for entry in drafts.iter().flat_map(|draft| context.cells.entries_of(draft)) {
        let view = &context.cells.views[entry.run as usize];
        let blocks = || view.places(entry.factor).map(|place| place.block);
        for a in blocks().filter(|&a| a != NONE) {
            pairs.extend(blocks().filter(|&b| b != NONE && a < b).map(|b| (a, b)));
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    Some(pairs)
}

/// Lists the chunk's cells and factors, and cuts them into batches.
fn fill(
    context: &Context<'_>,
    drafts: &[Draft],
    groups: &[(&[u32], usize)],
    chunk: &mut Chunk,
) -> Result<(), Error> {
    let count = drafts.iter().map(|draft| draft.num_entries as usize).sum();
    chunk.factors.reserve(count);
    chunk.shape_of.reserve(count);
    chunk.locals.reserve(count);
    chunk.cells.reserve(drafts.len());
    let mut shapes = Shapes::new(context.problem, &context.cells.views, context.looks);
    let mut batch = Batch::default();
    let (mut batch_start, mut rows, mut bundler, mut pattern) = (0, 0, Bundler::default(), 0);
    for (c, draft) in drafts.iter().enumerate() {
        if chunk.factors.len() + draft.num_entries as usize > batch_start + FACTORS_PER_BATCH
            && !batch.cells.is_empty()
        {
            let next = chunk.stretches.len();
            let done = std::mem::replace(
                &mut batch,
                Batch { stretches: next..next, cells: c..c, ..Batch::default() },
            );
            bundler.close(chunk, &shapes.shapes, done);
            batch_start = chunk.factors.len();
            chunk.rows_len = chunk.rows_len.max(rows);
            rows = 0;
        }
        while groups[pattern].1 <= c {
            pattern += 1;
        }
        let first = [chunk.factors.len(), chunk.locals.len()];
        let first_row = rows;
        let mut single = draft.dof == 3 && draft.num_entries == draft.num_blocks;
        for &entry in context.cells.entries_of(draft) {
            let number = shapes.add(entry, groups[pattern].0, &mut chunk.locals)?;
            let facts = &shapes.facts[number as usize];
            let i = chunk.factors.len();
            chunk.factors.push(entry.factor);
            chunk.shape_of.push(number);
            rows += facts.rows_len;
            single &= facts.single;
            match chunk.stretches[batch.stretches.clone()].last_mut() {
                Some(last) if (last.run, last.own) == (entry.run, facts.own) => last.end = i + 1,
                _ => {
                    chunk.stretches.push(Stretch { run: entry.run, own: facts.own, start: i, end: i + 1 });
                    batch.stretches.end += 1;
                }
            }
        }
        batch.cells.end = c + 1;
        let p = draft.dof as usize;
        let cell = Cell {
            pattern: pattern as u32,
            dof: draft.dof,
            single,
            store: draft.store,
            slot: draft.slot,
            end: chunk.factors.len() as u32,
            stash: chunk.stash_len,
            step: chunk.steps.end,
        };
        chunk.cells.push(cell);
        if !single {
            bundler.add(chunk, &shapes.shapes, &cell, first, first_row);
        }
        if p > 0 {
            let dense = chunk.patterns[pattern].dense;
            chunk.stash_len += stash_len(p, dense, chunk.elimination);
            chunk.steps.end += p;
        }
    }
    if !batch.cells.is_empty() {
        bundler.close(chunk, &shapes.shapes, batch);
        chunk.rows_len = chunk.rows_len.max(rows);
    }
    chunk.shapes = shapes.shapes;
    Ok(())
}
