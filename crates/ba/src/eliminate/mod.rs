//! The Schur complement, point by point.
//!
//! With the residuals linearised as r + J_c δ_c + J_p δ_p (c kept, p eliminated) and damping λD, the normal equations are
//!
//! ```text
//! | C   W | |δ_c|     |g_c|      C = J_cᵀJ_c + λD_c,  V = J_pᵀJ_p + λD_p  (block diagonal: one small block per p)
//! | Wᵀ  V | |δ_p| = − |g_p|      W = J_cᵀJ_p,  g = Jᵀr
//! ```
//!
//! and, with V = LLᵀ, Y = L⁻¹Wᵀ and y = L⁻¹g_p,
//!
//! ```text
//! (C − YᵀY) δ_c = −(g_c − Yᵀy),      δ_p = −L⁻ᵀ (y + Y δ_c).
//! ```
//!
//! One pass over a chunk's cells linearises a batch of factors into rows, sums V, W, g of a cell while they are in the
//! nearest cache, and subtracts its YᵀY from the tiles of the chunk. L, y and Y stay in the chunk's stash for δ_p. λD_c is added
//! when the chunks' tiles are put together.

mod kernel;
mod lanes;

use crate::problem::Problem;
use crate::run::Rows;
use crate::structure::{Cell, Chunk, Shape};
use crate::variable::Values;

/// Largest variable that can be eliminated: beyond, the reduced system is the better place.
pub(crate) const MAX_ELIMINATED_DOF: usize = 6;

/// Numbers kept of a cell: L, y, g_p, the diagonal of J_pᵀJ_p, and Y.
pub(crate) fn stash_len(dof: usize, width: usize) -> usize {
    stash_head(dof) + dof * width
}

/// Those before Y.
fn stash_head(dof: usize) -> usize {
    dof * dof + 3 * dof
}

/// What a chunk sums up.
#[derive(Default)]
pub(crate) struct Sums {
    /// C − YᵀY without damping, in the chunk's tiles; of a block with itself only the lower triangle is meant.
    pub(crate) tiles: Vec<f64>,
    /// For each of the chunk's blocks, one after the other: g_c, Yᵀy and the diagonal of J_cᵀJ_c.
    pub(crate) vectors: Vec<f64>,
    pub(crate) stash: Vec<f64>,
    /// Cost of each factor, NaN where it does not exist.
    pub(crate) costs: Vec<f64>,
    rows: Vec<f64>,
    /// Wᵀ of the cell at hand.
    w: Vec<f64>,
    /// Largest component of g_p.
    pub(crate) gradient_max: f64,
}

impl Sums {
    pub(crate) fn new(chunk: &Chunk) -> Self {
        let widest = chunk.patterns.iter().map(|pattern| pattern.width).max().unwrap_or(0);
        Self {
            tiles: vec![0.0; chunk.tiles_len],
            vectors: vec![0.0; 3 * chunk.vector_len],
            stash: vec![0.0; chunk.stash_len],
            costs: vec![0.0; chunk.factors.len()],
            rows: vec![0.0; chunk.rows_len + kernel::SLACK],
            w: vec![0.0; MAX_ELIMINATED_DOF * widest],
            gradient_max: 0.0,
        }
    }

    /// Linearises the chunk's factors and eliminates its variables, with damping `lambda`.
    pub(crate) fn linearize(
        &mut self,
        problem: &Problem,
        values: &Values,
        shapes: &[Shape],
        chunk: &Chunk,
        lambda: f64,
    ) {
        self.tiles.fill(0.0);
        self.vectors.fill(0.0);
        self.gradient_max = 0.0;
        let (mut factor, mut local) = (0, 0);
        for batch in &chunk.batches {
            let mut at = 0;
            for stretch in &chunk.stretches[batch.stretches.clone()] {
                let run = &problem.runs[stretch.run as usize];
                let len = (stretch.end - stretch.start) * run.rows() * run.stride();
                let rows = Rows {
                    rows: &mut self.rows[at..at + len],
                    costs: &mut self.costs[stretch.start..stretch.end],
                };
                run.linearize(values, &chunk.factors[stretch.start..stretch.end], rows);
                at += len;
            }
            kernel::eliminate(self, shapes, chunk, batch.cells.clone(), lambda, &mut factor, &mut local);
        }
    }

    /// The step of each eliminated variable of the chunk, given that of the kept ones; and what the step promises: gᵀδ and
    /// λ δᵀDδ over these variables.
    pub(crate) fn back_substitute(
        &self,
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
            let stash = CellStash::of(&self.stash, cell, chunk);
            step.copy_from_slice(stash.reduced_gradient);
            let pattern = &chunk.patterns[cell.pattern as usize];
            let locals = &chunk.pattern_locals[pattern.locals.clone()];
            kernel::multiply(stash.y, pattern.width, locals, &kept, step);
            // Lᵀ δ = −(y + Y δ_c), from the last row up.
            for k in (0..p).rev() {
                let (this, below) = step[k..].split_first_mut().expect("k is below p");
                let mut sum = -*this;
                for (i, step) in below.iter().enumerate() {
                    sum -= stash.factor[(k + 1 + i) * p + k] * step;
                }
                *this = sum / stash.factor[k * p + k];
            }
            for (k, component) in step.iter().enumerate() {
                promise[0] += stash.gradient[k] * component;
                promise[1] += lambda * stash.diagonal[k] * component * component;
            }
        }
        promise
    }
}

/// The parts of a cell's stash.
pub(crate) struct CellStash<'a> {
    /// L, row by row.
    pub(crate) factor: &'a [f64],
    /// y.
    pub(crate) reduced_gradient: &'a [f64],
    /// g_p.
    pub(crate) gradient: &'a [f64],
    /// The diagonal of J_pᵀJ_p.
    pub(crate) diagonal: &'a [f64],
    /// Y: a row over the pattern's blocks for each direction of the variable.
    pub(crate) y: &'a [f64],
}

impl<'a> CellStash<'a> {
    pub(crate) fn of(stash: &'a [f64], cell: &Cell, chunk: &Chunk) -> Self {
        let p = cell.dof as usize;
        let width = chunk.patterns[cell.pattern as usize].width;
        let (head, y) = stash[cell.stash..][..stash_len(p, width)].split_at(stash_head(p));
        let (factor, rest) = head.split_at(p * p);
        let (reduced_gradient, rest) = rest.split_at(p);
        let (gradient, diagonal) = rest.split_at(p);
        Self { factor, reduced_gradient, gradient, diagonal, y }
    }
}

/// λD of a direction with this entry on the diagonal of JᵀJ: Marquardt's scaling, which makes the step independent of units. A
/// direction that no factor sees gets a one, and stays where it is.
#[inline(always)]
pub(crate) fn damping(diagonal: f64, lambda: f64) -> f64 {
    if diagonal > 0.0 { lambda * diagonal } else { 1.0 }
}
