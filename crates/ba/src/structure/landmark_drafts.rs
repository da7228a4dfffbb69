//! Factors and column blocks of each landmark block, and the order of the landmark blocks.

use std::ops::Range;

use rayon::prelude::*;

use crate::problem::Problem;

use super::block::{Location, NONE};
use super::ordering::{FactorScan, Status, Variables};

/// Factors between the same kept variables are collected in landmark blocks (without a landmark) of
/// at most this many.
const FACTORS_PER_KEPT_BLOCK: usize = 1024;
/// Variables that one parallel job drafts.
const VARIABLES_PER_JOB: usize = 1024;

/// A factor: its group and its index in the group.
#[derive(Clone, Copy)]
pub(super) struct FactorRef {
    pub(super) group: u16,
    pub(super) factor: u32,
}

/// A landmark block before it is assigned to a task.
#[derive(Clone, Copy)]
pub(super) struct Draft {
    /// Its [`DraftSet`], and its first column block there.
    set: u32,
    first_block: u32,
    pub(super) num_blocks: u32,
    first_factor: u32,
    pub(super) num_factors: u32,
    pub(super) dof: u32,
    pub(super) store: u32,
    pub(super) slot: u32,
}

impl Draft {
    /// Estimated time of linearisation and elimination, in units of a product of two blocks.
    pub(super) fn work(&self) -> usize {
        let blocks = if self.dof == 0 { 0 } else { self.num_blocks as usize };
        6 * self.num_factors as usize + blocks * (blocks + 1) / 2
    }
}

/// Locations of the variables of a group's factors.
pub(super) struct GroupView<'a> {
    slots: &'a [u32],
    /// Locations of all variables of the type at each position.
    locations: Vec<&'a [Location]>,
}

impl<'a> GroupView<'a> {
    /// Views of all groups.
    pub(super) fn all(problem: &'a Problem, locations: &'a [Vec<Location>]) -> Vec<Self> {
        let locations_of =
            |stores: &[u16]| stores.iter().map(|&store| &locations[store as usize][..]).collect();
        let factor_groups = problem.factor_groups.iter();
        factor_groups
            .map(|group| Self { slots: group.all_slots(), locations: locations_of(group.stores()) })
            .collect()
    }

    /// Locations of a factor's variables.
    #[inline]
    pub(super) fn locations(&self, factor: u32) -> impl Iterator<Item = &'a Location> {
        let count = self.locations.len();
        let slots = &self.slots[factor as usize * count..][..count];
        self.locations.iter().zip(slots).map(|(locations, &slot)| &locations[slot as usize])
    }
}

/// All landmark blocks before they are assigned to tasks.
pub(super) struct LandmarkDrafts<'a> {
    sets: Vec<DraftSet>,
    pub(super) factor_refs: Vec<FactorRef>,
    pub(super) views: Vec<GroupView<'a>>,
}

/// Landmark blocks that one parallel job drafted.
#[derive(Default)]
struct DraftSet {
    drafts: Vec<Draft>,
    /// The sorted column blocks of each draft.
    blocks: Vec<u32>,
    /// Sort key and index of each draft; sorted after [`DraftSet::done`].
    keys: Vec<u128>,
}

impl DraftSet {
    fn with_capacity(drafts: usize, blocks: usize) -> Self {
        Self {
            drafts: Vec::with_capacity(drafts),
            blocks: Vec::with_capacity(blocks),
            keys: Vec::with_capacity(drafts),
        }
    }

    fn push(&mut self, draft: Draft) {
        let blocks = &self.blocks[draft.first_block as usize..][..draft.num_blocks as usize];
        // Block indices are below 2³¹, because that is the limit on degrees of freedom.
        let first = blocks.first().map_or(0, |&block| u128::from(block) + 1);
        let after = |i: usize| match blocks.get(i - 1..=i) {
            Some(two) => u128::from((two[1] - two[0]).min(u32::from(u16::MAX))),
            None => 0,
        };
        let rest = u128::from(hash(blocks));
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

impl<'a> LandmarkDrafts<'a> {
    /// Collects the factors and the column blocks of every landmark block.
    pub(super) fn draft(
        problem: &'a Problem,
        variables: &Variables,
        scan: &FactorScan,
        locations: &'a [Vec<Location>],
    ) -> Self {
        let total = variables.len();
        let mut start = vec![0u32; total + 2];
        for &landmark in &scan.landmark_of {
            start[landmark as usize + 1] += 1;
        }
        for i in 0..=total {
            start[i + 1] += start[i];
        }
        let mut fill = start.clone();
        let mut factor_refs = vec![FactorRef { group: 0, factor: 0 }; scan.landmark_of.len()];
        let mut landmark_of = scan.landmark_of.iter();
        for (group, factors) in (0u16..).zip(&problem.factor_groups) {
            for (factor, &landmark) in (0u32..factors.len() as u32).zip(landmark_of.by_ref()) {
                let at = &mut fill[landmark as usize];
                factor_refs[*at as usize] = FactorRef { group, factor };
                *at += 1;
            }
        }
        let views = GroupView::all(problem, locations);
        let mut work_items = Vec::new();
        for (store, ends) in (0u32..).zip(variables.first.windows(2)) {
            let firsts = (ends[0]..ends[1]).step_by(VARIABLES_PER_JOB);
            work_items.extend(
                firsts.map(|first| (store, first..ends[1].min(first + VARIABLES_PER_JOB as u32))),
            );
        }
        let set = |(number, (store, range)): (usize, (u32, Range<u32>))| {
            let ends = [start[range.start as usize], start[range.end as usize]];
            let mut set = DraftSet::with_capacity(range.len(), (ends[1] - ends[0]) as usize);
            let dof = problem.values.stores[store as usize].dof() as u32;
            for landmark in range {
                let ends = [start[landmark as usize], start[landmark as usize + 1]];
                if variables.statuses[landmark as usize] != Status::Eliminated || ends[0] == ends[1]
                {
                    continue;
                }
                let factor_refs = &factor_refs[ends[0] as usize..ends[1] as usize];
                let blocks = collect_blocks(&views, factor_refs, &mut set.blocks);
                set.push(Draft {
                    set: number as u32,
                    first_block: blocks.start as u32,
                    num_blocks: blocks.len() as u32,
                    first_factor: ends[0],
                    num_factors: ends[1] - ends[0],
                    dof,
                    store,
                    slot: landmark - variables.first[store as usize],
                });
            }
            set.done()
        };
        let sets = work_items.into_par_iter().enumerate().map(set).collect();
        let mut landmarks = Self { sets, factor_refs, views };
        landmarks.draft_kept(start[total] as usize..start[total + 1] as usize);
        landmarks
    }

    /// Collects the factors without a landmark by the column blocks that they share.
    fn draft_kept(&mut self, factor_refs: Range<usize>) {
        let mut set = DraftSet::default();
        let mut singles: Vec<_> = factor_refs
            .clone()
            .map(|i| {
                (
                    collect_blocks(&self.views, &self.factor_refs[i..=i], &mut set.blocks),
                    self.factor_refs[i],
                )
            })
            .collect();
        singles.sort_by(|a, b| {
            let blocks = set.blocks[a.0.clone()].cmp(&set.blocks[b.0.clone()]);
            blocks.then((a.1.group, a.1.factor).cmp(&(b.1.group, b.1.factor)))
        });
        for (i, single) in factor_refs.clone().zip(&singles) {
            self.factor_refs[i] = single.1;
        }
        let mut at = 0;
        while at < singles.len() {
            let blocks = singles[at].0.clone();
            let same = |other: &&(Range<usize>, FactorRef)| {
                set.blocks[other.0.clone()] == set.blocks[blocks.clone()]
            };
            let len = singles[at..].iter().take(FACTORS_PER_KEPT_BLOCK).take_while(same).count();
            set.push(Draft {
                set: self.sets.len() as u32,
                first_block: blocks.start as u32,
                num_blocks: blocks.len() as u32,
                first_factor: (factor_refs.start + at) as u32,
                num_factors: len as u32,
                dof: 0,
                store: 0,
                slot: 0,
            });
            at += len;
        }
        self.sets.push(set.done());
    }

    /// The sorted column blocks of a draft.
    pub(super) fn blocks_of(&self, draft: &Draft) -> &[u32] {
        &self.sets[draft.set as usize].blocks[draft.first_block as usize..]
            [..draft.num_blocks as usize]
    }

    /// The factors of a draft.
    pub(super) fn factors_of(&self, draft: &Draft) -> &[FactorRef] {
        &self.factor_refs[draft.first_factor as usize..][..draft.num_factors as usize]
    }

    /// The drafts sorted by their first three column blocks, those without a landmark last. This
    /// keeps tiles, points and factors local in memory, and makes equal patterns neighbours, which
    /// are then eliminated together.
    pub(super) fn sorted_drafts(&self) -> Vec<Draft> {
        let count = self.sets.iter().map(|set| set.drafts.len()).sum();
        let (mut keys, mut drafts) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for set in &self.sets {
            let first = drafts.len() as u128;
            keys.extend(set.keys.iter().map(|key| key + first));
            drafts.extend(&set.drafts);
        }
        // A merge of sorted runs.
        keys.par_sort();
        keys.into_iter().map(|key| drafts[key as u32 as usize]).collect()
    }
}

/// Hash of block indices.
fn hash(blocks: &[u32]) -> u32 {
    let step = |sum: u64, &block| {
        (sum ^ u64::from(block)).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29)
    };
    (blocks.iter().fold(0, step) >> 32) as u32
}

/// Appends the sorted distinct column blocks of some factors.
fn collect_blocks(
    views: &[GroupView<'_>],
    factor_refs: &[FactorRef],
    blocks: &mut Vec<u32>,
) -> Range<usize> {
    let begin = blocks.len();
    let mut sorted = true;
    for factor_ref in factor_refs {
        for location in views[factor_ref.group as usize].locations(factor_ref.factor) {
            let last = blocks.get(begin..).and_then(<[u32]>::last);
            if location.block != NONE && last != Some(&location.block) {
                sorted &= last.is_none_or(|&last| last < location.block);
                blocks.push(location.block);
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
