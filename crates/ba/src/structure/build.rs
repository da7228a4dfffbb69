//! Builds a task: its patterns, then its landmark blocks and factors in order, cut into batches.

use super::clusters::{Cluster, Clusters};
use super::context::Context;
use super::landmark_drafts::{Draft, FactorRef};
use super::patterns;
use super::rank_updates::RankUpdateBuilder;
use super::shapes::Shapes;
use super::stash::stash_len;
use super::task::{Batch, FactorRange, LandmarkBlock, Task};
use crate::error::Error;

/// Factors that are linearised together. 96 factors × 2 rows × 16 numbers are 24 KiB, which fits a
/// first-level cache; with fewer factors, fewer landmark blocks share one product YᵀY.
const FACTORS_PER_BATCH: usize = 96;

/// Builds the task of the drafted landmark blocks. `first_step` is the offset of its steps in the
/// step of the whole problem.
pub(super) fn build(
    context: &Context<'_>,
    drafts: &[Draft],
    first_step: usize,
) -> Result<Task, Error> {
    let mut task = Task::new(context.elimination, first_step);
    let Clusters { drafts, clusters } = Clusters::new(context.drafts, drafts, context.elimination);
    patterns::find(context, &drafts, &clusters, &mut task)?;
    fill(context, &drafts, &clusters, &mut task)?;
    Ok(task)
}

/// Lists the task's landmark blocks and factors, and cuts them into batches.
fn fill(
    context: &Context<'_>,
    drafts: &[Draft],
    clusters: &[Cluster<'_>],
    task: &mut Task,
) -> Result<(), Error> {
    let count = drafts.iter().map(|draft| draft.num_factors as usize).sum();
    task.factors.indices.reserve(count);
    task.factors.shape_of.reserve(count);
    task.factors.block_indices.reserve(count);
    task.landmarks.reserve(drafts.len());
    let mut filling = Filling {
        context,
        shapes: Shapes::new(context.problem, &context.drafts.views, context.classes),
        rank_update_builder: RankUpdateBuilder::default(),
        batch: Batch::default(),
        first_factor: 0,
        rows: 0,
    };
    let mut pattern = 0;
    for (c, draft) in drafts.iter().enumerate() {
        if filling.is_full(draft, task) {
            filling.close_batch(task);
        }
        while clusters[pattern].end <= c {
            pattern += 1;
        }
        filling.add_landmark(draft, pattern, clusters[pattern].blocks, task)?;
    }
    if !filling.batch.landmarks.is_empty() {
        filling.close_batch(task);
    }
    task.factors.shapes = filling.shapes.shapes;
    Ok(())
}

/// State of a task under construction.
struct Filling<'a> {
    context: &'a Context<'a>,
    shapes: Shapes<'a>,
    rank_update_builder: RankUpdateBuilder,
    /// The open batch, its first factor, and the length of its Jacobian rows so far.
    batch: Batch,
    first_factor: usize,
    rows: usize,
}

impl Filling<'_> {
    /// Whether a landmark block has to go into the next batch.
    fn is_full(&self, draft: &Draft, task: &Task) -> bool {
        let count = task.factors.indices.len() + draft.num_factors as usize;
        count > self.first_factor + FACTORS_PER_BATCH && !self.batch.landmarks.is_empty()
    }

    /// Adds the open batch to the task and opens the next one.
    fn close_batch(&mut self, task: &mut Task) {
        let (factor_range, landmark) = (task.factor_ranges.len(), task.landmarks.len());
        let next = Batch {
            factor_ranges: factor_range..factor_range,
            landmarks: landmark..landmark,
            ..Batch::default()
        };
        let done = std::mem::replace(&mut self.batch, next);
        self.rank_update_builder.close(task, &self.shapes.shapes, done);
        self.first_factor = task.factors.indices.len();
        task.rows_len = task.rows_len.max(self.rows);
        self.rows = 0;
    }

    /// Adds a landmark block with its factors. `blocks` are the column blocks of its pattern.
    fn add_landmark(
        &mut self,
        draft: &Draft,
        pattern: usize,
        blocks: &[u32],
        task: &mut Task,
    ) -> Result<(), Error> {
        let first = [task.factors.indices.len(), task.factors.block_indices.len()];
        let first_row = self.rows;
        let mut single = draft.dof == 3 && draft.num_factors == draft.num_blocks;
        for &factor_ref in self.context.drafts.factors_of(draft) {
            single &= self.add_factor(factor_ref, blocks, task)?;
        }
        let landmark = LandmarkBlock {
            pattern: pattern as u32,
            dof: draft.dof,
            single,
            store: draft.store,
            slot: draft.slot,
            end: task.factors.indices.len() as u32,
            stash: task.stash_len,
            step: task.steps.end,
        };
        task.landmarks.push(landmark);
        self.batch.landmarks.end = task.landmarks.len();
        if !single {
            self.rank_update_builder.add(task, &self.shapes.shapes, &landmark, first, first_row);
        }
        let p = draft.dof as usize;
        if p > 0 {
            task.stash_len +=
                stash_len(p, task.patterns.of(&landmark).packed_width, task.elimination);
            task.steps.end += p;
        }
        Ok(())
    }

    /// Adds a factor to the current landmark block. Returns whether the factor allows the block to
    /// be [`single`](LandmarkBlock::single).
    fn add_factor(
        &mut self,
        factor_ref: FactorRef,
        blocks: &[u32],
        task: &mut Task,
    ) -> Result<bool, Error> {
        let number = self.shapes.add(factor_ref, blocks, &mut task.factors.block_indices)?;
        let info = &self.shapes.infos[number as usize];
        let i = task.factors.indices.len();
        task.factors.indices.push(factor_ref.factor);
        task.factors.shape_of.push(number);
        self.rows += info.rows_len;
        match task.factor_ranges[self.batch.factor_ranges.clone()].last_mut() {
            Some(last)
                if (last.group, last.landmark_position)
                    == (factor_ref.group, info.landmark_position) =>
            {
                last.end = i + 1
            }
            _ => {
                task.factor_ranges.push(FactorRange {
                    group: factor_ref.group,
                    landmark_position: info.landmark_position,
                    start: i,
                    end: i + 1,
                });
                self.batch.factor_ranges.end += 1;
            }
        }
        Ok(info.single)
    }
}
