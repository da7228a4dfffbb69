//! Linearisation, elimination and back-substitution of one task.

use super::batch::BatchElimination;
use super::cursor::Cursor;
use super::stash::LandmarkStash;
use super::workspace::{SLACK, Workspace};
use crate::factor_group::Rows;
use crate::problem::Problem;
use crate::structure::{LandmarkBlock, SINGLE_ROWS, Task, triangle_row};
use crate::variable::Values;

/// Sums of a task, except its tiles and stash, which are in the memory of all tasks.
#[derive(Default)]
pub(crate) struct Sums {
    /// For each of the task's blocks: g_c, Yᵀy and the diagonal of J_cᵀJ_c.
    pub(crate) vectors: Vec<f64>,
    /// Cost of each factor; NaN if it is invalid.
    pub(crate) costs: Vec<f64>,
    rows: Vec<f64>,
    /// Y and y of the landmarks that are eliminated together.
    w: Vec<f64>,
    y: Vec<f64>,
    /// See [`single`](super::single).
    projected: Vec<f64>,
    /// Largest component of g_p.
    pub(crate) gradient_max: f64,
    /// Sum of the costs of the valid factors.
    pub(crate) cost: f64,
    /// Number of invalid factors.
    pub(crate) missing: usize,
}

impl Sums {
    pub(crate) fn new(task: &Task) -> Self {
        let widest =
            task.patterns.list.iter().map(|pattern| pattern.padded_width).max().unwrap_or(0);
        Self {
            vectors: vec![0.0; 3 * task.vector_len],
            costs: vec![0.0; task.factors.indices.len()],
            rows: vec![0.0; task.rows_len + SLACK],
            w: vec![
                0.0;
                most_at_once(task, |landmark| landmark.dof as usize
                    * task.patterns.of(landmark).padded_width)
            ],
            y: vec![0.0; most_at_once(task, |landmark| landmark.dof as usize)],
            projected: vec![0.0; SINGLE_ROWS * widest],
            ..Self::default()
        }
    }

    /// Linearises the task's factors and eliminates its landmarks with damping `lambda`. `memory`
    /// is the task's part of the memory.
    pub(crate) fn linearize(
        &mut self,
        memory: &mut [f64],
        problem: &Problem,
        values: &Values,
        task: &Task,
        lambda: f64,
    ) {
        let (tiles, stash) = memory.split_at_mut(task.tiles_len);
        tiles.fill(0.0);
        self.vectors.fill(0.0);
        let Self { vectors, rows, w, y, projected, .. } = self;
        let mut workspace =
            Workspace { tiles, stash, vectors, rows, w, y, projected, gradient_max: 0.0 };
        let mut cursor = Cursor::default();
        for batch in &task.batches {
            let mut at = 0;
            for factor_range in &task.factor_ranges[batch.factor_ranges.clone()] {
                let group = &problem.factor_groups[factor_range.group as usize];
                let len = (factor_range.end - factor_range.start) * group.rows() * group.stride();
                let rows = Rows {
                    rows: &mut workspace.rows[at..at + len],
                    costs: &mut self.costs[factor_range.start..factor_range.end],
                };
                group.linearize(values, &task.factors.indices[factor_range.start..], rows);
                at += len;
            }
            BatchElimination {
                workspace: &mut workspace,
                task,
                batch,
                lambda,
                cursor: &mut cursor,
            }
            .eliminate();
        }
        self.gradient_max = workspace.gradient_max;
        (self.cost, self.missing) = (0.0, 0);
        for &cost in &self.costs {
            self.cost += if cost.is_nan() { 0.0 } else { cost };
            self.missing += usize::from(cost.is_nan());
        }
    }

    /// Writes the step of each of the task's landmarks, given the step of the kept variables.
    /// Returns gᵀδ and λ δᵀDδ over these landmarks, for the model cost change.
    pub(crate) fn back_substitute(
        memory: &[f64],
        task: &Task,
        kept_step: &[f64],
        block_at: &[usize],
        lambda: f64,
        steps: &mut [f64],
    ) -> [f64; 2] {
        let mut kept = vec![0.0; task.vector_len];
        let ends = task.blocks.iter().skip(1).map(|next| next.1).chain([task.vector_len]);
        for (&(block, at), end) in task.blocks.iter().zip(ends) {
            let from = block_at[block as usize];
            kept[at..end].copy_from_slice(&kept_step[from..from + end - at]);
        }
        let mut model_terms = [0.0; 2];
        for landmark in task.landmarks.iter().filter(|landmark| landmark.dof > 0) {
            let p = landmark.dof as usize;
            let step = &mut steps[landmark.step - task.steps.start..][..p];
            let stash = LandmarkStash::of(memory, landmark, task);
            step.copy_from_slice(stash.reduced_gradient);
            let pattern_blocks = task.patterns.blocks_of(landmark);
            stash.y.multiply(pattern_blocks, &kept, step);
            // gᵀδ = (Ly)ᵀδ = −yᵀ(y + Y δ_c).
            for (y, sum) in stash.reduced_gradient.iter().zip(&*step) {
                model_terms[0] -= y * sum;
            }
            // Lᵀ δ = −(y + Y δ_c), from the last row up.
            for k in (0..p).rev() {
                let (this, below) = step[k..].split_first_mut().expect("k is below p");
                let mut sum = -*this;
                for (i, step) in (k + 1..p).zip(below) {
                    sum -= stash.factor[triangle_row(i) + k] * *step;
                }
                *this = sum * stash.factor[triangle_row(k) + k];
            }
            for (k, component) in step.iter().enumerate() {
                model_terms[1] += lambda * stash.diagonal(k, lambda) * component * component;
            }
        }
        model_terms
    }
}

/// Largest sum of `need` over landmark blocks that are eliminated together: those of a batch with
/// the same pattern.
fn most_at_once(task: &Task, need: impl Fn(&LandmarkBlock) -> usize) -> usize {
    let batches = task.batches.iter();
    let clusters = batches.flat_map(|batch| {
        task.landmarks[batch.landmarks.clone()].chunk_by(|a, b| a.pattern == b.pattern)
    });
    clusters.map(|landmarks| landmarks.iter().map(&need).sum()).max().unwrap_or(0)
}
