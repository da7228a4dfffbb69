//! Blocks of the reduced system and their order: each kept variable finds its place.

use std::collections::BTreeMap;

use crate::error::Error;
use crate::problem::Problem;
use crate::variable::{Meta, Order, Role};

use super::block::{Block, NONE, Place};
use super::elimination::Elimination;
use super::tile::padded;

/// Variables are not merged into blocks wider than this.
const MAX_MERGED_DOF: usize = 24;

/// What becomes of a variable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Fate {
    Fixed,
    Kept,
    Eliminated,
}

/// All variables, counted over all stores.
pub(super) struct Variables {
    /// The first of each store, and their number.
    pub(super) first: Vec<u32>,
    pub(super) fates: Vec<Fate>,
}

impl Variables {
    pub(super) fn of(problem: &Problem, elimination: Elimination) -> Self {
        let (mut first, mut fates) = (vec![0], Vec::with_capacity(problem.num_variables()));
        for metas in &problem.metas {
            fates.extend(metas.iter().map(|meta| match meta.role {
                _ if meta.free == 0 => Fate::Fixed,
                Role::Eliminated if elimination != Elimination::Ignore => Fate::Eliminated,
                _ => Fate::Kept,
            }));
            first.push(fates.len() as u32);
        }
        Self { first, fates }
    }

    pub(super) fn len(&self) -> usize {
        self.fates.len()
    }

    /// The first of the store of each of a factor's variables.
    pub(super) fn firsts(&self, stores: &[u16]) -> Vec<u32> {
        stores.iter().map(|&store| self.first[store as usize]).collect()
    }
}

/// What one look at every factor tells.
pub(super) struct Scan {
    /// For each factor, run by run, its eliminated variable; the number of variables where it has
    /// none.
    pub(super) owners: Vec<u32>,
    /// For each kept variable, the one that always stands next behind it in factors with an
    /// eliminated variable, as it always stands next before that one; [`NONE`] if there is none.
    next: Vec<u32>,
}

/// In place of a variable: none was seen yet; none stands there; not always the same one does.
const UNSEEN: u32 = NONE;
const NOBODY: u32 = NONE - 1;
const DIFFERS: u32 = NONE - 2;

fn meet(link: &mut u32, variable: u32) {
    if *link != variable {
        *link = if *link == UNSEEN { variable } else { DIFFERS };
    }
}

pub(super) fn scan(problem: &Problem, variables: &Variables) -> Result<Scan, Error> {
    let fates = &variables.fates;
    let nobody = fates.len() as u32;
    let mut owners = Vec::with_capacity(problem.num_factors());
    let (mut after, mut before) = (vec![UNSEEN; fates.len()], vec![UNSEEN; fates.len()]);
    for run in &problem.runs {
        let firsts = variables.firsts(run.stores());
        for (index, slots) in run.all_slots().chunks_exact(firsts.len()).enumerate() {
            let mut owner = None;
            for (position, (slot, first)) in slots.iter().zip(&firsts).enumerate() {
                if fates[(first + slot) as usize] == Fate::Eliminated
                    && let Some((first, _)) = owner.replace((position, first + slot))
                {
                    let (factor, second) = (run.factor_type(), position);
                    return Err(Error::TwoEliminated { factor, index, first, second });
                }
            }
            owners.push(owner.map_or(nobody, |owner| owner.1));
            if owner.is_none() {
                continue;
            }
            let mut previous = NOBODY;
            for (slot, first) in slots.iter().zip(&firsts) {
                let this = first + slot;
                let kept = fates[this as usize] == Fate::Kept;
                // Only what stands side by side in the rows, with nothing fixed or eliminated
                // between.
                if previous != NOBODY {
                    meet(&mut after[previous as usize], if kept { this } else { NOBODY });
                }
                if kept {
                    meet(&mut before[this as usize], previous);
                }
                previous = if kept { this } else { NOBODY };
            }
            if previous != NOBODY {
                meet(&mut after[previous as usize], NOBODY);
            }
        }
    }
    for (this, next) in after.iter_mut().enumerate() {
        if *next >= DIFFERS || before[*next as usize] != this as u32 {
            *next = NONE;
        }
    }
    Ok(Scan { owners, next: after })
}

/// Where all variables are.
pub(super) struct Placed {
    pub(super) blocks: Vec<Block>,
    pub(super) places: Vec<Vec<Place>>,
    /// By [`Place::class`].
    pub(super) looks: Vec<Look>,
}

/// What matters of a variable to the shape of its factors.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Look {
    /// Which of its directions are free.
    pub(super) free: u64,
    pub(super) eliminated: bool,
    /// First column in its block.
    pub(super) offset: u32,
    /// Columns of its block; 0 where it has none.
    pub(super) block_dof: u32,
}

/// Decides blocks and their order. A chain of inseparable variables becomes one block; it stands
/// where the earliest of them wants to.
pub(super) fn place(problem: &Problem, variables: &Variables, scan: &Scan) -> Placed {
    let mut has_previous = vec![false; variables.len()];
    for &next in scan.next.iter().filter(|&&next| next != NONE) {
        has_previous[next as usize] = true;
    }
    let of = |variable: u32| {
        let store = variables.first.partition_point(|&first| first <= variable) - 1;
        let slot = (variable - variables.first[store]) as usize;
        (store, slot, problem.metas[store][slot], problem.values.stores[store].dof())
    };
    // Chains one after the other, and for each its order and its end.
    let (mut members, mut chains): (Vec<u32>, Vec<(Order, std::ops::Range<usize>)>) =
        (Vec::new(), Vec::new());
    for first in 0..variables.len() as u32 {
        if variables.fates[first as usize] != Fate::Kept || has_previous[first as usize] {
            continue;
        }
        let (mut begin, mut order, mut width, mut at) = (members.len(), Order::Shared, 0, first);
        while at != NONE {
            let (_, _, meta, dof) = of(at);
            if width + dof > MAX_MERGED_DOF && width > 0 {
                chains.push((order, begin..members.len()));
                (begin, order, width) = (members.len(), Order::Shared, 0);
            }
            order = order.min(order_of(meta));
            width += dof;
            members.push(at);
            at = scan.next[at as usize];
        }
        chains.push((order, begin..members.len()));
    }
    chains.sort_by_key(|chain| chain.0);
    let nowhere = Place { block: NONE, offset: 0, class: 0 };
    let mut places: Vec<_> = problem.metas.iter().map(|metas| vec![nowhere; metas.len()]).collect();
    let (mut blocks, mut at, mut reduced) = (Vec::with_capacity(chains.len()), 0, 0);
    for (_, chain) in chains {
        let mut block = Block { dof: 0, at, free: 0, reduced };
        for &member in &members[chain] {
            let (store, slot, meta, dof) = of(member);
            (places[store][slot].block, places[store][slot].offset) =
                (blocks.len() as u32, block.dof as u32);
            block.free |= meta.free << block.dof;
            block.dof += dof;
        }
        at += padded(block.dof);
        reduced += block.num_free();
        blocks.push(block);
    }
    let looks = classify(problem, variables, &blocks, &mut places);
    Placed { blocks, places, looks }
}

/// Numbers the different looks of variables.
fn classify(
    problem: &Problem,
    variables: &Variables,
    blocks: &[Block],
    places: &mut [Vec<Place>],
) -> Vec<Look> {
    let (mut numbers, mut looks) = (BTreeMap::new(), Vec::<Look>::new());
    let mut fates = variables.fates.iter();
    for (metas, places) in problem.metas.iter().zip(places) {
        let mut last = 0;
        for ((meta, place), fate) in metas.iter().zip(places).zip(fates.by_ref()) {
            let look = Look {
                free: meta.free,
                eliminated: *fate == Fate::Eliminated,
                offset: place.offset,
                block_dof: blocks.get(place.block as usize).map_or(0, |block| block.dof as u32),
            };
            if looks.get(last as usize) != Some(&look) {
                last = *numbers.entry(look).or_insert(looks.len() as u32);
                looks.extend((last as usize == looks.len()).then_some(look));
            }
            place.class = last;
        }
    }
    looks
}

fn order_of(meta: Meta) -> Order {
    match meta.role {
        Role::Kept(order) => order,
        Role::Eliminated => Order::Shared,
    }
}
