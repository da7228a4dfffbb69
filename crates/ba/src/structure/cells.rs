//! Which factors and which blocks each cell has, and the order of the cells.

use std::ops::Range;

use rayon::prelude::*;

use crate::problem::Problem;

use super::place::{Fate, Scan, Variables};
use super::{NONE, Place};

/// Factors that join the same kept variables are bunched in cells of at most so many.
const FACTORS_PER_KEPT_CELL: usize = 1024;
/// Cells whose blocks one task collects.
const CELLS_PER_TASK: usize = 1024;

/// A factor on its way into a chunk.
#[derive(Clone, Copy)]
pub(super) struct Entry {
    pub(super) run: u16,
    pub(super) factor: u32,
}

/// A cell on its way into a chunk.
#[derive(Clone, Copy)]
pub(super) struct Draft {
    first_block: usize,
    pub(super) num_blocks: u32,
    first_entry: u32,
    pub(super) num_entries: u32,
    pub(super) dof: u32,
    pub(super) store: u32,
    pub(super) slot: u32,
}

impl Draft {
    /// About how long its linearisation and elimination takes, in units of a product of two blocks.
    pub(super) fn work(&self) -> usize {
        let blocks = if self.dof == 0 { 0 } else { self.num_blocks as usize };
        6 * self.num_entries as usize + blocks * (blocks + 1) / 2
    }
}

/// All cells on their way into chunks.
pub(super) struct Cells {
    drafts: Vec<Draft>,
    pub(super) entries: Vec<Entry>,
    /// The sorted blocks of each cell.
    blocks: Vec<u32>,
}

impl Cells {
    /// Collects the factors of every cell, and its blocks.
    pub(super) fn draft(
        problem: &Problem,
        variables: &Variables,
        scan: &Scan,
        places: &[Vec<Place>],
    ) -> Self {
        let total = variables.len();
        let mut start = vec![0u32; total + 2];
        for &owner in &scan.owners {
            start[owner as usize + 1] += 1;
        }
        for i in 0..=total {
            start[i + 1] += start[i];
        }
        let mut fill = start.clone();
        let mut entries = vec![Entry { run: 0, factor: 0 }; scan.owners.len()];
        let mut owners = scan.owners.iter();
        for (run, factors) in (0u16..).zip(&problem.runs) {
            for (factor, &owner) in (0u32..factors.len() as u32).zip(owners.by_ref()) {
                let at = &mut fill[owner as usize];
                entries[*at as usize] = Entry { run, factor };
                *at += 1;
            }
        }
        let mut cells = Self { drafts: Vec::new(), entries, blocks: Vec::new() };
        for store in 0..problem.metas.len() {
            let range = variables.first[store]..variables.first[store + 1];
            let owners: Vec<u32> = range
                .filter(|&i| {
                    variables.fates[i as usize] == Fate::Eliminated
                        && start[i as usize] < start[i as usize + 1]
                })
                .collect();
            let dof = problem.values.stores[store].dof() as u32;
            let part = |owners: &[u32]| {
                let (mut blocks, mut drafts) = (Vec::new(), Vec::with_capacity(owners.len()));
                for &owner in owners {
                    let entries = start[owner as usize] as usize..start[owner as usize + 1] as usize;
                    let range = collect_blocks(problem, places, &cells.entries[entries.clone()], &mut blocks);
                    drafts.push(Draft {
                        first_block: range.start,
                        num_blocks: range.len() as u32,
                        first_entry: entries.start as u32,
                        num_entries: entries.len() as u32,
                        dof,
                        store: store as u32,
                        slot: owner - variables.first[store],
                    });
                }
                (blocks, drafts)
            };
            let parts: Vec<_> = owners.par_chunks(CELLS_PER_TASK).map(part).collect();
            for (blocks, drafts) in parts {
                let shift = cells.blocks.len();
                cells.blocks.extend(blocks);
                let moved = |draft: Draft| Draft { first_block: draft.first_block + shift, ..draft };
                cells.drafts.extend(drafts.into_iter().map(moved));
            }
        }
        cells.draft_kept(problem, places, start[total] as usize..start[total + 1] as usize);
        cells
    }

    /// Bunches the factors without an eliminated variable by the blocks that they join.
    fn draft_kept(&mut self, problem: &Problem, places: &[Vec<Place>], entries: Range<usize>) {
        let mut singles: Vec<_> = entries
            .clone()
            .map(|i| {
                (collect_blocks(problem, places, &self.entries[i..=i], &mut self.blocks), self.entries[i])
            })
            .collect();
        singles.sort_by(|a, b| {
            let blocks = self.blocks[a.0.clone()].cmp(&self.blocks[b.0.clone()]);
            blocks.then((a.1.run, a.1.factor).cmp(&(b.1.run, b.1.factor)))
        });
        for (i, single) in entries.clone().zip(&singles) {
            self.entries[i] = single.1;
        }
        let mut at = 0;
        while at < singles.len() {
            let blocks = singles[at].0.clone();
            let same =
                |other: &&(Range<usize>, Entry)| self.blocks[other.0.clone()] == self.blocks[blocks.clone()];
            let len = singles[at..].iter().take(FACTORS_PER_KEPT_CELL).take_while(same).count();
            self.drafts.push(Draft {
                first_block: blocks.start,
                num_blocks: blocks.len() as u32,
                first_entry: (entries.start + at) as u32,
                num_entries: len as u32,
                dof: 0,
                store: 0,
                slot: 0,
            });
            at += len;
        }
    }

    /// The sorted blocks of a cell.
    pub(super) fn blocks_of(&self, draft: &Draft) -> &[u32] {
        &self.blocks[draft.first_block..][..draft.num_blocks as usize]
    }

    /// The factors of a cell.
    pub(super) fn entries_of(&self, draft: &Draft) -> &[Entry] {
        &self.entries[draft.first_entry as usize..][..draft.num_entries as usize]
    }

    /// The cells sorted by their first blocks, those without a variable last. Only neighbours with equal patterns gain from
    /// the order; beyond three blocks it makes no difference.
    pub(super) fn sorted_drafts(&self) -> Vec<Draft> {
        let mut keys: Vec<u128> = (0u128..)
            .zip(&self.drafts)
            .map(|(index, draft)| {
                let blocks = self.blocks_of(draft);
                // Block numbers are below 2³¹, for there are at most so many degrees of freedom.
                let block = |i: usize| blocks.get(i).map_or(0, |&block| u128::from(block) + 1);
                u128::from(draft.dof == 0) << 127 | block(0) << 95 | block(1) << 63 | block(2) << 32 | index
            })
            .collect();
        keys.par_sort_unstable();
        keys.into_iter().map(|key| self.drafts[key as u32 as usize]).collect()
    }
}

/// Appends the sorted distinct blocks of some factors.
fn collect_blocks(
    problem: &Problem,
    places: &[Vec<Place>],
    entries: &[Entry],
    blocks: &mut Vec<u32>,
) -> Range<usize> {
    let begin = blocks.len();
    for entry in entries {
        let run = &problem.runs[entry.run as usize];
        for (&store, &slot) in run.stores().iter().zip(run.slots(entry.factor as usize)) {
            let block = places[store as usize][slot as usize].block;
            if block != NONE && blocks.len() > begin && blocks[blocks.len() - 1] == block {
                continue;
            }
            if block != NONE {
                blocks.push(block);
            }
        }
    }
    blocks[begin..].sort_unstable();
    let mut end = begin;
    for i in begin..blocks.len() {
        if end == begin || blocks[i] != blocks[end - 1] {
            blocks[end] = blocks[i];
            end += 1;
        }
    }
    blocks.truncate(end);
    begin..end
}
