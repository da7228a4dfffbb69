//! The symbolic structure of a problem, before any numbers: column blocks of the reduced system,
//! landmark blocks to eliminate, and parallel tasks.
//!
//! * A **column block** ([`ColumnBlock`]) is a range of columns of the reduced system: one kept
//!   variable, or several that always occur together beside an eliminated one (a camera's own
//!   intrinsics and its pose). One merged block needs one product instead of four.
//! * A **landmark block** ([`LandmarkBlock`]) is one eliminated variable (landmark) with all its
//!   factors, or a set of factors between the same kept variables, without a landmark. Its
//!   **pattern** is a sorted list of distinct column blocks that contains those of its factors.
//!   Products are taken over the pattern, not over factors, and for all landmark blocks of a
//!   pattern together.
//! * A **task** ([`Task`]) is a range of landmark blocks, sorted by their column blocks, that one
//!   thread eliminates. It sums into tiles of its own, only for the column blocks that it uses, and
//!   the sums of the tasks are added in order. The number of tasks depends on the problem alone,
//!   and so does every rounding error.
//!
//! A partly fixed variable keeps its full width here, with zero columns, so that blocks stay
//! uniform. Fixed columns are left out when the reduced system is formed.

mod block;
mod build;
mod clusters;
mod context;
mod elimination;
mod landmark_drafts;
mod ordering;
mod parallel;
mod patterns;
mod rank_updates;
mod shape;
mod shapes;
mod stash;
mod task;
mod tile;

use rayon::prelude::*;

use crate::error::Error;
use crate::problem::Problem;

pub(crate) use block::{ColumnBlock, Location, NONE};
use context::Context;
pub(crate) use elimination::Elimination;
use landmark_drafts::{Draft, LandmarkDrafts};
use ordering::{BlockOrdering, Variables};
pub(crate) use parallel::for_each_task;
pub(crate) use shape::{NO_LANDMARK, Shape};
pub(crate) use stash::{stash_head, stash_len, triangle_row};
pub(crate) use task::{Batch, LandmarkBlock, PatternBlock, RankUpdate, SINGLE_ROWS, Task, pair};
pub(crate) use tile::{padded, tile_index, tile_lanes, tile_len};

/// Factors of a task: about 100 µs of work.
pub(crate) const FACTORS_PER_TASK: usize = 4096;
/// More tasks than cores would only cost memory.
const MAX_TASKS: usize = 64;

/// The symbolic structure of a problem.
pub(crate) struct Structure {
    pub(crate) blocks: Vec<ColumnBlock>,
    /// Length of padded vectors over all column blocks.
    pub(crate) kept_len: usize,
    /// Columns of the reduced system.
    pub(crate) columns: usize,
    pub(crate) tasks: Vec<Task>,
    /// Total length of the tiles and stashes of all tasks.
    pub(crate) memory_len: usize,
    /// For each store and variable: offset of its step, or `variable::FIXED`.
    pub(crate) step_offsets: Vec<Vec<u32>>,
    pub(crate) step_len: usize,
    pub(crate) locations: Vec<Vec<Location>>,
}

impl Structure {
    pub(crate) fn new(problem: &Problem, elimination: Elimination) -> Result<Self, Error> {
        check_sizes(problem)?;
        let variables = Variables::of(problem, elimination);
        let scan = ordering::scan(problem, &variables)?;
        let BlockOrdering { blocks, locations, classes } =
            ordering::order_blocks(problem, &variables, &scan);
        let landmark_drafts = LandmarkDrafts::draft(problem, &variables, &scan, &locations);
        let drafts = landmark_drafts.sorted_drafts();
        let kept_len: usize = blocks.iter().map(|block| padded(block.dof)).sum();
        let mut step_len = kept_len;
        let work: usize = drafts.iter().map(Draft::work).sum();
        let count = num_tasks(landmark_drafts.factor_refs.len());
        let mut parts = Vec::with_capacity(count);
        let (mut rest, mut done) = (&drafts[..], 0);
        while !rest.is_empty() {
            // Boundaries follow the cumulative work, so that an unequal split does not add up.
            let end = (work * (parts.len() + 1)).div_ceil(count);
            let (begin, mut len) = (step_len, 0);
            while let Some(draft) = rest.get(len).filter(|_| done < end) {
                done += draft.work();
                step_len += draft.dof as usize;
                len += 1;
            }
            let (these, others) = rest.split_at(len);
            rest = others;
            parts.push((these, begin));
        }
        let context = Context {
            problem,
            blocks: &blocks,
            classes: &classes,
            drafts: &landmark_drafts,
            elimination,
        };
        // Of several errors, the first in order is returned.
        let tasks: Vec<Result<Task, Error>> = parts
            .into_par_iter()
            .with_max_len(1)
            .map(|(these, step)| build::build(&context, these, step))
            .collect();
        let mut tasks = tasks.into_iter().collect::<Result<Vec<_>, _>>()?;
        let mut memory_len = 0;
        for task in &mut tasks {
            // Whole cache lines, so that no two tasks write to the same one.
            let len = (task.tiles_len + task.stash_len).next_multiple_of(8);
            task.memory = memory_len..memory_len + len;
            memory_len += len;
        }
        let mut step_offsets: Vec<Vec<u32>> = (locations.iter())
            .map(|locations| {
                let at = |location: &Location| match location.block {
                    NONE => crate::variable::FIXED,
                    block => (blocks[block as usize].padded_start as u32) + location.offset,
                };
                locations.iter().map(at).collect()
            })
            .collect();
        for landmark in
            tasks.iter().flat_map(|task| &task.landmarks).filter(|landmark| landmark.dof > 0)
        {
            step_offsets[landmark.store as usize][landmark.slot as usize] = landmark.step as u32;
        }
        let columns = blocks.iter().map(ColumnBlock::num_free).sum();
        Ok(Self { blocks, kept_len, columns, tasks, memory_len, step_offsets, step_len, locations })
    }

    /// Total number of elements of Y over all landmarks.
    pub(crate) fn num_coupled(&self) -> usize {
        let of_task = |task: &Task| -> usize {
            let of_landmark = |landmark: &LandmarkBlock| {
                landmark.dof as usize * task.patterns.of(landmark).packed_width
            };
            task.landmarks.iter().map(of_landmark).sum()
        };
        self.tasks.iter().map(of_task).sum()
    }

    /// All pairs of column blocks with a tile, sorted.
    pub(crate) fn tile_pairs(&self) -> Vec<(u32, u32)> {
        let mut pairs: Vec<_> = self
            .tasks
            .iter()
            .flat_map(|task| task.tiles.iter().map(|tile| (tile.a, tile.b)))
            .collect();
        pairs.extend((0..self.blocks.len() as u32).map(|block| (block, block)));
        pairs.sort_unstable();
        pairs.dedup();
        pairs
    }
}

/// Number of tasks for this many factors. Multiples of four divide evenly among two or four
/// threads.
fn num_tasks(factors: usize) -> usize {
    let tasks = factors.div_ceil(FACTORS_PER_TASK).max(1);
    if tasks == 1 { 1 } else { tasks.next_multiple_of(4).min(MAX_TASKS) }
}

fn check_sizes(problem: &Problem) -> Result<(), Error> {
    let check = |what, count, limit| {
        if count > limit { Err(Error::TooLarge { what, count, limit }) } else { Ok(()) }
    };
    let limit = u32::MAX as usize - 1;
    check("factors", problem.num_factors(), limit)?;
    let numbers = problem.values.stores.iter().map(|store| store.len() * store.dof()).sum();
    check("degrees of freedom", numbers, limit / 2)?;
    check("factor types", problem.factor_groups.len(), u16::MAX as usize)
}
