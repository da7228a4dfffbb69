//! What one pass over a chunk sums up, and the steps that follow from what it leaves.

use super::cursor::At;
use super::kernel::Work;
use super::stash::CellStash;
use super::workspace::{Room, SLACK};
use crate::problem::Problem;
use crate::run::Rows;
use crate::structure::{Cell, Chunk, SINGLE_ROWS, row};
use crate::variable::Values;

/// What a chunk sums up, apart from its tiles and its stash, which live in the memory of all
/// chunks.
#[derive(Default)]
pub(crate) struct Sums {
    /// For each of the chunk's blocks, one after the other: g_c, Yᵀy and the diagonal of J_cᵀJ_c.
    pub(crate) vectors: Vec<f64>,
    /// Cost of each factor, NaN where it does not exist.
    pub(crate) costs: Vec<f64>,
    rows: Vec<f64>,
    /// Y of the cells at hand, and their y.
    w: Vec<f64>,
    y: Vec<f64>,
    /// See [`single`](super::single).
    turned: Vec<f64>,
    /// Largest component of g_p.
    pub(crate) gradient_max: f64,
    /// Sum of the costs of the factors that exist.
    pub(crate) cost: f64,
    /// How many do not.
    pub(crate) missing: usize,
}

impl Sums {
    pub(crate) fn new(chunk: &Chunk) -> Self {
        let widest = chunk.patterns.list.iter().map(|pattern| pattern.width).max().unwrap_or(0);
        Self {
            vectors: vec![0.0; 3 * chunk.vector_len],
            costs: vec![0.0; chunk.factors.numbers.len()],
            rows: vec![0.0; chunk.rows_len + SLACK],
            w: vec![
                0.0;
                most_at_once(chunk, |cell| cell.dof as usize * chunk.patterns.of(cell).width)
            ],
            y: vec![0.0; most_at_once(chunk, |cell| cell.dof as usize)],
            turned: vec![0.0; SINGLE_ROWS * widest],
            ..Self::default()
        }
    }

    /// Linearises the chunk's factors and eliminates its variables, with damping `lambda`, in the
    /// chunk's part of the memory.
    pub(crate) fn linearize(
        &mut self,
        memory: &mut [f64],
        problem: &Problem,
        values: &Values,
        chunk: &Chunk,
        lambda: f64,
    ) {
        let (tiles, stash) = memory.split_at_mut(chunk.tiles_len);
        tiles.fill(0.0);
        self.vectors.fill(0.0);
        let Self { vectors, rows, w, y, turned, .. } = self;
        let mut room = Room { tiles, stash, vectors, rows, w, y, turned, gradient_max: 0.0 };
        let mut done = At::default();
        for batch in &chunk.batches {
            let mut at = 0;
            for stretch in &chunk.stretches[batch.stretches.clone()] {
                let run = &problem.runs[stretch.run as usize];
                let len = (stretch.end - stretch.start) * run.rows() * run.stride();
                let rows = Rows {
                    rows: &mut room.rows[at..at + len],
                    costs: &mut self.costs[stretch.start..stretch.end],
                };
                run.linearize(values, &chunk.factors.numbers[stretch.start..], rows);
                at += len;
            }
            Work { room: &mut room, chunk, batch, lambda, at: &mut done }.eliminate();
        }
        self.gradient_max = room.gradient_max;
        (self.cost, self.missing) = (0.0, 0);
        for &cost in &self.costs {
            self.cost += if cost.is_nan() { 0.0 } else { cost };
            self.missing += usize::from(cost.is_nan());
        }
    }

    /// The step of each eliminated variable of the chunk, given that of the kept ones; and what the
    /// step promises: gᵀδ and λ δᵀDδ over these variables.
    pub(crate) fn back_substitute(
        memory: &[f64],
        chunk: &Chunk,
        kept_step: &[f64],
        block_at: &[usize],
        lambda: f64,
        steps: &mut [f64],
    ) -> [f64; 2] {
        let mut kept = vec![0.0; chunk.vector_len];
        let ends = chunk.blocks.iter().skip(1).map(|next| next.1).chain([chunk.vector_len]);
        for (&(block, at), end) in chunk.blocks.iter().zip(ends) {
            let from = block_at[block as usize];
            kept[at..end].copy_from_slice(&kept_step[from..from + end - at]);
        }
        let mut promise = [0.0; 2];
        for cell in chunk.cells.iter().filter(|cell| cell.dof > 0) {
            let p = cell.dof as usize;
            let step = &mut steps[cell.step - chunk.steps.start..][..p];
            let stash = CellStash::of(memory, cell, chunk);
            step.copy_from_slice(stash.reduced_gradient);
            let locals = chunk.patterns.locals_of(cell);
            stash.y.multiply(locals, &kept, step);
            // gᵀδ = (Ly)ᵀδ = −yᵀ(y + Y δ_c).
            for (y, sum) in stash.reduced_gradient.iter().zip(&*step) {
                promise[0] -= y * sum;
            }
            // Lᵀ δ = −(y + Y δ_c), from the last row up.
            for k in (0..p).rev() {
                let (this, below) = step[k..].split_first_mut().expect("k is below p");
                let mut sum = -*this;
                for (i, step) in (k + 1..p).zip(below) {
                    sum -= stash.factor[row(i) + k] * *step;
                }
                *this = sum * stash.factor[row(k) + k];
            }
            for (k, component) in step.iter().enumerate() {
                promise[1] += lambda * stash.diagonal(k, lambda) * component * component;
            }
        }
        promise
    }
}

/// The largest sum of what cells need that are worked on at once: those of a batch with the same
/// pattern.
fn most_at_once(chunk: &Chunk, need: impl Fn(&Cell) -> usize) -> usize {
    let batches = chunk.batches.iter();
    let groups = batches
        .flat_map(|batch| chunk.cells[batch.cells.clone()].chunk_by(|a, b| a.pattern == b.pattern));
    groups.map(|cells| cells.iter().map(&need).sum()).max().unwrap_or(0)
}
