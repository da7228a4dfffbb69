//! Which factors and which blocks each cell has, and the order of the cells.

use std::ops::Range;

use rayon::prelude::*;

use crate::problem::Problem;

use super::block::{NONE, Place};
use super::place::{Fate, Scan, Variables};

/// Factors that join the same kept variables are bunched in cells of at most so many.
const FACTORS_PER_KEPT_CELL: usize = 1024;
/// Variables whose cells one task drafts.
const VARIABLES_PER_TASK: usize = 1024;

/// A factor on its way into a chunk.
#[derive(Clone, Copy)]
pub(super) struct Entry {
    pub(super) run: u16,
    pub(super) factor: u32,
}

/// A cell on its way into a chunk.
#[derive(Clone, Copy)]
pub(super) struct Draft {
    /// The part that it is in, and where in that its blocks begin.
    part: u32,
    first_block: u32,
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

/// The variables of a run's factors.
pub(super) struct View<'a> {
    slots: &'a [u32],
    /// Where those are that stand first, second and so on.
    places: Vec<&'a [Place]>,
}

impl<'a> View<'a> {
    /// Of all runs.
    pub(super) fn all(problem: &'a Problem, places: &'a [Vec<Place>]) -> Vec<Self> {
        let places_of =
            |stores: &[u16]| stores.iter().map(|&store| &places[store as usize][..]).collect();
        let runs = problem.runs.iter();
        runs.map(|run| Self { slots: run.all_slots(), places: places_of(run.stores()) }).collect()
    }

    /// Where a factor's variables are.
    #[inline]
    pub(super) fn places(&self, factor: u32) -> impl Iterator<Item = &'a Place> {
        let count = self.places.len();
        let slots = &self.slots[factor as usize * count..][..count];
        self.places.iter().zip(slots).map(|(places, &slot)| &places[slot as usize])
    }
}

/// All cells on their way into chunks.
pub(super) struct Cells<'a> {
    parts: Vec<Part>,
    pub(super) entries: Vec<Entry>,
    pub(super) views: Vec<View<'a>>,
}

/// Some cells.
#[derive(Default)]
struct Part {
    drafts: Vec<Draft>,
    /// The sorted blocks of each.
    blocks: Vec<u32>,
    /// By what each is sorted, then its number; in order once it is done.
    keys: Vec<u128>,
}

impl Part {
    fn with_capacity(drafts: usize, blocks: usize) -> Self {
        Self {
            drafts: Vec::with_capacity(drafts),
            blocks: Vec::with_capacity(blocks),
            keys: Vec::with_capacity(drafts),
        }
    }

    fn push(&mut self, draft: Draft) {
        let blocks = &self.blocks[draft.first_block as usize..][..draft.num_blocks as usize];
        // Block numbers are below 2³¹, for there are at most so many degrees of freedom.
        let first = blocks.first().map_or(0, |&block| u128::from(block) + 1);
        let after = |i: usize| match blocks.get(i - 1..=i) {
            Some(two) => u128::from((two[1] - two[0]).min(u32::from(u16::MAX))),
            None => 0,
        };
        let rest = u128::from(mixed(blocks));
        let number = self.drafts.len() as u128;
        self.keys.push(
            u128::from(draft.dof == 0) << 127
                | first << 96
                | after(1) << 80
                | after(2) << 64
                | rest << 32
                | number,
        );
        self.drafts.push(draft);
    }

    fn done(mut self) -> Self {
        self.keys.sort_unstable();
        self
    }
}

impl<'a> Cells<'a> {
    /// Collects the factors of every cell, and its blocks.
    pub(super) fn draft(
        problem: &'a Problem,
        variables: &Variables,
        scan: &Scan,
        places: &'a [Vec<Place>],
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
        let views = View::all(problem, places);
        let mut tasks = Vec::new();
        for (store, ends) in (0u32..).zip(variables.first.windows(2)) {
            let firsts = (ends[0]..ends[1]).step_by(VARIABLES_PER_TASK);
            tasks.extend(
                firsts.map(|first| (store, first..ends[1].min(first + VARIABLES_PER_TASK as u32))),
            );
        }
        let part = |(number, (store, range)): (usize, (u32, Range<u32>))| {
            let ends = [start[range.start as usize], start[range.end as usize]];
            let mut part = Part::with_capacity(range.len(), (ends[1] - ends[0]) as usize);
            let dof = problem.values.stores[store as usize].dof() as u32;
            for owner in range {
                let ends = [start[owner as usize], start[owner as usize + 1]];
                if variables.fates[owner as usize] != Fate::Eliminated || ends[0] == ends[1] {
                    continue;
                }
                let entries = &entries[ends[0] as usize..ends[1] as usize];
                let blocks = collect_blocks(&views, entries, &mut part.blocks);
                part.push(Draft {
                    part: number as u32,
                    first_block: blocks.start as u32,
                    num_blocks: blocks.len() as u32,
                    first_entry: ends[0],
                    num_entries: ends[1] - ends[0],
                    dof,
                    store,
                    slot: owner - variables.first[store as usize],
                });
            }
            part.done()
        };
        let parts = tasks.into_par_iter().enumerate().map(part).collect();
        let mut cells = Self { parts, entries, views };
        cells.draft_kept(start[total] as usize..start[total + 1] as usize);
        cells
    }

    /// Bunches the factors without an eliminated variable by the blocks that they join.
    fn draft_kept(&mut self, entries: Range<usize>) {
        let mut part = Part::default();
        let mut singles: Vec<_> = entries
            .clone()
            .map(|i| {
                (
                    collect_blocks(&self.views, &self.entries[i..=i], &mut part.blocks),
                    self.entries[i],
                )
            })
            .collect();
        singles.sort_by(|a, b| {
            let blocks = part.blocks[a.0.clone()].cmp(&part.blocks[b.0.clone()]);
            blocks.then((a.1.run, a.1.factor).cmp(&(b.1.run, b.1.factor)))
        });
        for (i, single) in entries.clone().zip(&singles) {
            self.entries[i] = single.1;
        }
        let mut at = 0;
        while at < singles.len() {
            let blocks = singles[at].0.clone();
            let same = |other: &&(Range<usize>, Entry)| {
                part.blocks[other.0.clone()] == part.blocks[blocks.clone()]
            };
            let len = singles[at..].iter().take(FACTORS_PER_KEPT_CELL).take_while(same).count();
            part.push(Draft {
                part: self.parts.len() as u32,
                first_block: blocks.start as u32,
                num_blocks: blocks.len() as u32,
                first_entry: (entries.start + at) as u32,
                num_entries: len as u32,
                dof: 0,
                store: 0,
                slot: 0,
            });
            at += len;
        }
        self.parts.push(part.done());
    }

    /// The sorted blocks of a cell.
    pub(super) fn blocks_of(&self, draft: &Draft) -> &[u32] {
        &self.parts[draft.part as usize].blocks[draft.first_block as usize..]
            [..draft.num_blocks as usize]
    }

    /// The factors of a cell.
    pub(super) fn entries_of(&self, draft: &Draft) -> &[Entry] {
        &self.entries[draft.first_entry as usize..][..draft.num_entries as usize]
    }

    /// The cells sorted by their first three blocks, those without a variable last, so that tiles,
    /// points and factors stay near; and so that equal patterns are neighbours, which are then
    /// worked on at once.
    pub(super) fn sorted_drafts(&self) -> Vec<Draft> {
        let count = self.parts.iter().map(|part| part.drafts.len()).sum();
        let (mut keys, mut drafts) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for part in &self.parts {
            let first = drafts.len() as u128;
            keys.extend(part.keys.iter().map(|key| key + first));
            drafts.extend(&part.drafts);
        }
        // Merges what is in order already.
        keys.par_sort();
        keys.into_iter().map(|key| drafts[key as u32 as usize]).collect()
    }
}

/// The same number for the same blocks, and nearly always others for others.
fn mixed(blocks: &[u32]) -> u32 {
    let step = |sum: u64, &block| {
        (sum ^ u64::from(block)).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29)
    };
    (blocks.iter().fold(0, step) >> 32) as u32
}

/// Appends the sorted distinct blocks of some factors.
fn collect_blocks(views: &[View<'_>], entries: &[Entry], blocks: &mut Vec<u32>) -> Range<usize> {
    let begin = blocks.len();
    let mut sorted = true;
    for entry in entries {
        for place in views[entry.run as usize].places(entry.factor) {
            let last = blocks.get(begin..).and_then(<[u32]>::last);
            if place.block != NONE && last != Some(&place.block) {
                sorted &= last.is_none_or(|&last| last < place.block);
                blocks.push(place.block);
            }
        }
    }
    if !sorted {
        blocks[begin..].sort_unstable();
        let mut end = begin;
        for i in begin..blocks.len() {
            if end == begin || blocks[i] != blocks[end - 1] {
                blocks[end] = blocks[i];
                end += 1;
            }
        }
        blocks.truncate(end);
    }
    begin..blocks.len()
}
