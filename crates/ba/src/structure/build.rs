//! Building a chunk: its patterns, then its cells and factors in order, cut into batches.

use super::bundles::Bundler;
use super::cells::{Draft, Entry};
use super::chunk::{Batch, Cell, Chunk, Stretch};
use super::context::Context;
use super::groups::{Group, Groups};
use super::patterns;
use super::shapes::Shapes;
use super::stash::stash_len;
use crate::error::Error;

/// Rows of so many factors are linearised at once: 96 × 2 rows × 16 numbers are 24 KiB, half of a
/// first-level cache; fewer make products of few cells.
const FACTORS_PER_BATCH: usize = 96;

/// Builds the chunk of some cells, whose steps begin at `first_step`.
pub(super) fn build(
    context: &Context<'_>,
    drafts: &[Draft],
    first_step: usize,
) -> Result<Chunk, Error> {
    let mut chunk = Chunk::new(context.elimination, first_step);
    let Groups { drafts, groups } = Groups::new(context.cells, drafts, context.elimination);
    patterns::find(context, &drafts, &groups, &mut chunk)?;
    fill(context, &drafts, &groups, &mut chunk)?;
    Ok(chunk)
}

/// Lists the chunk's cells and factors, and cuts them into batches.
fn fill(
    context: &Context<'_>,
    drafts: &[Draft],
    groups: &[Group<'_>],
    chunk: &mut Chunk,
) -> Result<(), Error> {
    let count = drafts.iter().map(|draft| draft.num_entries as usize).sum();
    chunk.factors.numbers.reserve(count);
    chunk.factors.shape_of.reserve(count);
    chunk.factors.locals.reserve(count);
    chunk.cells.reserve(drafts.len());
    let mut filling = Filling {
        context,
        shapes: Shapes::new(context.problem, &context.cells.views, context.looks),
        bundler: Bundler::default(),
        batch: Batch::default(),
        first_factor: 0,
        rows: 0,
    };
    let mut pattern = 0;
    for (c, draft) in drafts.iter().enumerate() {
        if filling.is_full(draft, chunk) {
            filling.close_batch(chunk);
        }
        while groups[pattern].end <= c {
            pattern += 1;
        }
        filling.add_cell(draft, pattern, groups[pattern].blocks, chunk)?;
    }
    if !filling.batch.cells.is_empty() {
        filling.close_batch(chunk);
    }
    chunk.factors.shapes = filling.shapes.shapes;
    Ok(())
}

/// A chunk that is being filled, as far as it does not tell itself.
struct Filling<'a> {
    context: &'a Context<'a>,
    shapes: Shapes<'a>,
    bundler: Bundler,
    /// The batch at hand, the first of its factors, and how many numbers are in its rows so far.
    batch: Batch,
    first_factor: usize,
    rows: usize,
}

impl Filling<'_> {
    /// Whether a cell has to go into the next batch.
    fn is_full(&self, draft: &Draft, chunk: &Chunk) -> bool {
        let count = chunk.factors.numbers.len() + draft.num_entries as usize;
        count > self.first_factor + FACTORS_PER_BATCH && !self.batch.cells.is_empty()
    }

    /// Adds the batch to the chunk, and begins the next one.
    fn close_batch(&mut self, chunk: &mut Chunk) {
        let (stretch, cell) = (chunk.stretches.len(), chunk.cells.len());
        let next = Batch { stretches: stretch..stretch, cells: cell..cell, ..Batch::default() };
        let done = std::mem::replace(&mut self.batch, next);
        self.bundler.close(chunk, &self.shapes.shapes, done);
        self.first_factor = chunk.factors.numbers.len();
        chunk.rows_len = chunk.rows_len.max(self.rows);
        self.rows = 0;
    }

    /// Adds a cell with its factors. `blocks` are those of its pattern.
    fn add_cell(
        &mut self,
        draft: &Draft,
        pattern: usize,
        blocks: &[u32],
        chunk: &mut Chunk,
    ) -> Result<(), Error> {
        let first = [chunk.factors.numbers.len(), chunk.factors.locals.len()];
        let first_row = self.rows;
        let mut single = draft.dof == 3 && draft.num_entries == draft.num_blocks;
        for &entry in self.context.cells.entries_of(draft) {
            single &= self.add_factor(entry, blocks, chunk)?;
        }
        let cell = Cell {
            pattern: pattern as u32,
            dof: draft.dof,
            single,
            store: draft.store,
            slot: draft.slot,
            end: chunk.factors.numbers.len() as u32,
            stash: chunk.stash_len,
            step: chunk.steps.end,
        };
        chunk.cells.push(cell);
        self.batch.cells.end = chunk.cells.len();
        if !single {
            self.bundler.add(chunk, &self.shapes.shapes, &cell, first, first_row);
        }
        let p = draft.dof as usize;
        if p > 0 {
            chunk.stash_len += stash_len(p, chunk.patterns.of(&cell).dense, chunk.elimination);
            chunk.steps.end += p;
        }
        Ok(())
    }

    /// Adds a factor to the cell at hand. Gives whether that may be [`single`](Cell::single) with
    /// it.
    fn add_factor(
        &mut self,
        entry: Entry,
        blocks: &[u32],
        chunk: &mut Chunk,
    ) -> Result<bool, Error> {
        let number = self.shapes.add(entry, blocks, &mut chunk.factors.locals)?;
        let facts = &self.shapes.facts[number as usize];
        let i = chunk.factors.numbers.len();
        chunk.factors.numbers.push(entry.factor);
        chunk.factors.shape_of.push(number);
        self.rows += facts.rows_len;
        match chunk.stretches[self.batch.stretches.clone()].last_mut() {
            Some(last) if (last.run, last.own) == (entry.run, facts.own) => last.end = i + 1,
            _ => {
                chunk.stretches.push(Stretch {
                    run: entry.run,
                    own: facts.own,
                    start: i,
                    end: i + 1,
                });
                self.batch.stretches.end += 1;
            }
        }
        Ok(facts.single)
    }
}
