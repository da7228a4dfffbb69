//! Merges kept variables into column blocks and orders the blocks for factorisation.

use std::collections::BTreeMap;

use crate::error::Error;
use crate::problem::Problem;
use crate::variable::{EliminationOrder, Meta, Role};

use super::block::{ColumnBlock, Location, NONE};
use super::elimination::Elimination;
use super::tile::padded;

/// Variables are not merged into blocks wider than this.
const MAX_MERGED_DOF: usize = 24;

/// Treatment of a variable by the linear solver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Status {
    Fixed,
    Kept,
    Eliminated,
}

/// All variables of the problem, numbered over all stores.
pub(super) struct Variables {
    /// Number of the first variable of each store, then the number of all variables.
    pub(super) first: Vec<u32>,
    pub(super) statuses: Vec<Status>,
}

impl Variables {
    pub(super) fn of(problem: &Problem, elimination: Elimination) -> Self {
        let (mut first, mut statuses) = (vec![0], Vec::with_capacity(problem.num_variables()));
        for metas in &problem.metas {
            statuses.extend(metas.iter().map(|meta| match meta.role {
                _ if meta.free == 0 => Status::Fixed,
                Role::Eliminated if elimination != Elimination::Ignore => Status::Eliminated,
                _ => Status::Kept,
            }));
            first.push(statuses.len() as u32);
        }
        Self { first, statuses }
    }

    pub(super) fn len(&self) -> usize {
        self.statuses.len()
    }

    /// Number of the first variable of each of a factor's stores.
    pub(super) fn firsts(&self, stores: &[u16]) -> Vec<u32> {
        stores.iter().map(|&store| self.first[store as usize]).collect()
    }
}

/// Result of one pass over all factors.
pub(super) struct FactorScan {
    /// For each factor, group by group: its eliminated variable, or the number of variables if it
    /// has none.
    pub(super) landmark_of: Vec<u32>,
    /// For each kept variable: the kept variable that always follows it in factors with a landmark,
    /// if it also always precedes that one; else [`NONE`].
    next: Vec<u32>,
}

/// Values of a link to a neighbouring variable: not seen yet, no neighbour, and not always the same
/// neighbour.
const UNSEEN: u32 = NONE;
const NO_NEIGHBOUR: u32 = NONE - 1;
const DIFFERS: u32 = NONE - 2;

/// Records that `variable` is the neighbour in one more factor.
fn update_link(link: &mut u32, variable: u32) {
    if *link != variable {
        *link = if *link == UNSEEN { variable } else { DIFFERS };
    }
}

/// Finds the landmark of each factor, and kept variables that always occur together.
pub(super) fn scan(problem: &Problem, variables: &Variables) -> Result<FactorScan, Error> {
    let statuses = &variables.statuses;
    let no_landmark = statuses.len() as u32;
    let mut landmark_of = Vec::with_capacity(problem.num_factors());
    let (mut after, mut before) = (vec![UNSEEN; statuses.len()], vec![UNSEEN; statuses.len()]);
    for group in &problem.factor_groups {
        let firsts = variables.firsts(group.stores());
        for (index, slots) in group.all_slots().chunks_exact(firsts.len()).enumerate() {
            let mut landmark = None;
            for (position, (slot, first)) in slots.iter().zip(&firsts).enumerate() {
                if statuses[(first + slot) as usize] == Status::Eliminated
                    && let Some((first, _)) = landmark.replace((position, first + slot))
                {
                    let (factor, second) = (group.factor_type(), position);
                    return Err(Error::TwoEliminated { factor, index, first, second });
                }
            }
            landmark_of.push(landmark.map_or(no_landmark, |landmark| landmark.1));
            if landmark.is_none() {
                continue;
            }
            let mut previous = NO_NEIGHBOUR;
            for (slot, first) in slots.iter().zip(&firsts) {
                let this = first + slot;
                let kept = statuses[this as usize] == Status::Kept;
                // Only variables that are adjacent in the rows, with no fixed or eliminated one
                // between.
                if previous != NO_NEIGHBOUR {
                    update_link(
                        &mut after[previous as usize],
                        if kept { this } else { NO_NEIGHBOUR },
                    );
                }
                if kept {
                    update_link(&mut before[this as usize], previous);
                }
                previous = if kept { this } else { NO_NEIGHBOUR };
            }
            if previous != NO_NEIGHBOUR {
                update_link(&mut after[previous as usize], NO_NEIGHBOUR);
            }
        }
    }
    for (this, next) in after.iter_mut().enumerate() {
        if *next >= DIFFERS || before[*next as usize] != this as u32 {
            *next = NONE;
        }
    }
    Ok(FactorScan { landmark_of, next: after })
}

/// Column blocks and the location of every variable.
pub(super) struct BlockOrdering {
    pub(super) blocks: Vec<ColumnBlock>,
    pub(super) locations: Vec<Vec<Location>>,
    /// Indexed by [`Location::class`].
    pub(super) classes: Vec<VariableClass>,
}

/// Properties of a variable that determine the shape of its factors.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct VariableClass {
    /// Bit i: tangent direction i is free.
    pub(super) free: u64,
    pub(super) eliminated: bool,
    /// First column in its block.
    pub(super) offset: u32,
    /// Columns of its block; 0 if it has none.
    pub(super) block_dof: u32,
}

/// Merges and orders kept variables. A chain of variables that always occur together becomes one
/// block, at the order of its earliest variable.
pub(super) fn order_blocks(
    problem: &Problem,
    variables: &Variables,
    scan: &FactorScan,
) -> BlockOrdering {
    let mut has_previous = vec![false; variables.len()];
    for &next in scan.next.iter().filter(|&&next| next != NONE) {
        has_previous[next as usize] = true;
    }
    let of = |variable: u32| {
        let store = variables.first.partition_point(|&first| first <= variable) - 1;
        let slot = (variable - variables.first[store]) as usize;
        (store, slot, problem.metas[store][slot], problem.values.stores[store].dof())
    };
    // Members of all chains, and for each chain its order and its range of members.
    let (mut members, mut chains): (Vec<u32>, Vec<(EliminationOrder, std::ops::Range<usize>)>) =
        (Vec::new(), Vec::new());
    for first in 0..variables.len() as u32 {
        if variables.statuses[first as usize] != Status::Kept || has_previous[first as usize] {
            continue;
        }
        let (mut begin, mut order, mut width, mut at) =
            (members.len(), EliminationOrder::Last, 0, first);
        while at != NONE {
            let (_, _, meta, dof) = of(at);
            if width + dof > MAX_MERGED_DOF && width > 0 {
                chains.push((order, begin..members.len()));
                (begin, order, width) = (members.len(), EliminationOrder::Last, 0);
            }
            order = order.min(order_of(meta));
            width += dof;
            members.push(at);
            at = scan.next[at as usize];
        }
        chains.push((order, begin..members.len()));
    }
    chains.sort_by_key(|chain| chain.0);
    let no_location = Location { block: NONE, offset: 0, class: 0 };
    let mut locations: Vec<_> =
        problem.metas.iter().map(|metas| vec![no_location; metas.len()]).collect();
    let (mut blocks, mut padded_start, mut first_column) = (Vec::with_capacity(chains.len()), 0, 0);
    for (_, chain) in chains {
        let mut block = ColumnBlock { dof: 0, padded_start, free: 0, first_column };
        for &member in &members[chain] {
            let (store, slot, meta, dof) = of(member);
            (locations[store][slot].block, locations[store][slot].offset) =
                (blocks.len() as u32, block.dof as u32);
            block.free |= meta.free << block.dof;
            block.dof += dof;
        }
        padded_start += padded(block.dof);
        first_column += block.num_free();
        blocks.push(block);
    }
    let classes = classify(problem, variables, &blocks, &mut locations);
    BlockOrdering { blocks, locations, classes }
}

/// Numbers the distinct classes of variables.
fn classify(
    problem: &Problem,
    variables: &Variables,
    blocks: &[ColumnBlock],
    locations: &mut [Vec<Location>],
) -> Vec<VariableClass> {
    let (mut numbers, mut classes) = (BTreeMap::new(), Vec::<VariableClass>::new());
    let mut statuses = variables.statuses.iter();
    for (metas, locations) in problem.metas.iter().zip(locations) {
        let mut last = 0;
        for ((meta, location), status) in metas.iter().zip(locations).zip(statuses.by_ref()) {
            let class = VariableClass {
                free: meta.free,
                eliminated: *status == Status::Eliminated,
                offset: location.offset,
                block_dof: blocks.get(location.block as usize).map_or(0, |block| block.dof as u32),
            };
            if classes.get(last as usize) != Some(&class) {
                last = *numbers.entry(class).or_insert(classes.len() as u32);
                classes.extend((last as usize == classes.len()).then_some(class));
            }
            location.class = last;
        }
    }
    classes
}

fn order_of(meta: Meta) -> EliminationOrder {
    match meta.role {
        Role::Kept(order) => order,
        Role::Eliminated => EliminationOrder::Last,
    }
}
