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
//! One pass over a chunk's cells linearises a batch of factors into rows, sums C of factors with the same blocks and V, W, g of a
//! cell while they are in the nearest cache, and subtracts YᵀY of cells with the same blocks from the tiles of the chunk. L, y and Y stay in the chunk's stash for δ_p. λD_c is added
//! when the chunks' tiles are put together.

mod cell;
mod kernel;
mod lanes;
mod normal;
mod path;
mod product;
mod single;

pub(crate) use path::{Path, path};
pub(crate) use single::ROWS as SINGLE_ROWS;

use crate::problem::Problem;
use crate::run::Rows;
use crate::structure::{Cell, Chunk, Elimination, Local};
use crate::variable::Values;

/// Largest variable that can be eliminated: beyond, the reduced system is the better place.
pub(crate) const MAX_ELIMINATED_DOF: usize = 6;

/// Numbers kept of a cell: L row by row, with the inverses of its diagonal in place of that, y, and Y: block by block, of each
/// block a row for each direction, without padding. The rest follows: g_p = Ly, and the diagonal of V is that of LLᵀ.
///
/// Y is in single precision, two in place of one, for it is most of the memory, and of what is read and written: a step of
/// eliminated variables that is wrong in the eighth digit is as good. Not where the reduced system is made of Y, for what is
/// left of C − YᵀY when λ is small may be less than that.
pub(crate) fn stash_len(dof: usize, dense: usize, elimination: Elimination) -> usize {
    let numbers = dof * dense + STASH_SLACK;
    stash_head(dof) + if elimination == Elimination::Implicit { numbers } else { numbers.div_ceil(2) }
}

/// The last vector of the last row may reach so far beyond it.
const STASH_SLACK: usize = 3;

/// Those before Y.
fn stash_head(dof: usize) -> usize {
    row(dof) + dof
}

/// Where a row of L begins.
#[inline(always)]
fn row(i: usize) -> usize {
    i * (i + 1) / 2
}

/// What a chunk sums up, apart from its tiles and its stash, which live in the memory of all chunks.
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
    /// See [`single`].
    turned: Vec<f64>,
    /// Largest component of g_p.
    pub(crate) gradient_max: f64,
    /// Sum of the costs of the factors that exist.
    pub(crate) cost: f64,
    /// How many do not.
    pub(crate) missing: usize,
}

/// What the kernel works on.
struct Room<'a> {
    /// C − YᵀY without damping, in the chunk's tiles; of a block with itself only the lower triangle is meant.
    tiles: &'a mut [f64],
    stash: &'a mut [f64],
    vectors: &'a mut [f64],
    rows: &'a mut [f64],
    w: &'a mut [f64],
    y: &'a mut [f64],
    turned: &'a mut [f64],
    gradient_max: f64,
}

impl Sums {
    pub(crate) fn new(chunk: &Chunk) -> Self {
        let widest = chunk.patterns.iter().map(|pattern| pattern.width).max().unwrap_or(0);
        Self {
            vectors: vec![0.0; 3 * chunk.vector_len],
            costs: vec![0.0; chunk.factors.len()],
            rows: vec![0.0; chunk.rows_len + kernel::SLACK],
            w: vec![
                0.0;
                most_at_once(chunk, |cell| cell.dof as usize
                    * chunk.patterns[cell.pattern as usize].width)
            ],
            y: vec![0.0; most_at_once(chunk, |cell| cell.dof as usize)],
            turned: vec![0.0; SINGLE_ROWS * widest],
            ..Self::default()
        }
    }

    /// Linearises the chunk's factors and eliminates its variables, with damping `lambda`, in the chunk's part of the memory.
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
        let mut done = kernel::At::default();
        for batch in &chunk.batches {
            let mut at = 0;
            for stretch in &chunk.stretches[batch.stretches.clone()] {
                let run = &problem.runs[stretch.run as usize];
                let len = (stretch.end - stretch.start) * run.rows() * run.stride();
                let rows = Rows {
                    rows: &mut room.rows[at..at + len],
                    costs: &mut self.costs[stretch.start..stretch.end],
                };
                run.linearize(values, &chunk.factors[stretch.start..], rows);
                at += len;
            }
            kernel::Work { room: &mut room, chunk, batch, lambda, at: &mut done }.eliminate();
        }
        self.gradient_max = room.gradient_max;
        (self.cost, self.missing) = (0.0, 0);
        for &cost in &self.costs {
            self.cost += if cost.is_nan() { 0.0 } else { cost };
            self.missing += usize::from(cost.is_nan());
        }
    }

    /// The step of each eliminated variable of the chunk, given that of the kept ones; and what the step promises: gᵀδ and
    /// λ δᵀDδ over these variables.
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
            let pattern = &chunk.patterns[cell.pattern as usize];
            let locals = &chunk.pattern_locals[pattern.locals.clone()];
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

/// The largest sum of what cells need that are worked on at once: those of a batch with the same pattern.
fn most_at_once(chunk: &Chunk, need: impl Fn(&Cell) -> usize) -> usize {
    let batches = chunk.batches.iter();
    let groups =
        batches.flat_map(|batch| chunk.cells[batch.cells.clone()].chunk_by(|a, b| a.pattern == b.pattern));
    groups.map(|cells| cells.iter().map(&need).sum()).max().unwrap_or(0)
}

/// The parts of a cell's stash.
pub(crate) struct CellStash<'a> {
    /// The lower triangle of L, row by row, with the inverses of its diagonal; 0 there for a direction that no factor sees.
    factor: &'a [f64],
    /// y.
    reduced_gradient: &'a [f64],
    pub(crate) y: Y<'a>,
}

/// Y: for each of the pattern's blocks, a row for each direction of the variable.
#[derive(Clone, Copy)]
pub(crate) enum Y<'a> {
    Single(&'a [f32]),
    Double(&'a [f64]),
}

impl Y<'_> {
    pub(crate) fn get(self, i: usize) -> f64 {
        match self {
            Self::Single(y) => f64::from(y[i]),
            Self::Double(y) => y[i],
        }
    }

    /// step += Y δ_c, where `kept` holds δ_c over the chunk's blocks, zero in the padding.
    pub(crate) fn multiply(self, locals: &[Local], kept: &[f64], step: &mut [f64]) {
        match self {
            Self::Single(y) => kernel::multiply(y, locals, kept, step),
            Self::Double(y) => kernel::multiply(y, locals, kept, step),
        }
    }

    /// kept += Yᵀ u.
    pub(crate) fn multiply_transposed(self, locals: &[Local], u: &[f64], kept: &mut [f64]) {
        match self {
            Self::Single(y) => kernel::multiply_transposed(y, locals, u, kept),
            Self::Double(y) => kernel::multiply_transposed(y, locals, u, kept),
        }
    }
}

impl<'a> CellStash<'a> {
    /// In the memory of all chunks.
    pub(crate) fn of(memory: &'a [f64], cell: &Cell, chunk: &Chunk) -> Self {
        let p = cell.dof as usize;
        let dense = chunk.patterns[cell.pattern as usize].dense;
        let (head, y) = memory[chunk.memory.start + chunk.tiles_len + cell.stash..]
            [..stash_len(p, dense, chunk.elimination)]
            .split_at(stash_head(p));
        let y = match chunk.elimination {
            Elimination::Implicit => Y::Double(y),
            _ => Y::Single(bytemuck::cast_slice(y)),
        };
        let (factor, reduced_gradient) = head.split_at(row(p));
        Self { factor, reduced_gradient, y }
    }

    /// A number of L's lower triangle; a one on its diagonal for a direction that no factor sees.
    pub(crate) fn factor(&self, i: usize, j: usize) -> f64 {
        let number = self.factor[row(i) + j];
        match i == j {
            true if number == 0.0 => 1.0,
            true => 1.0 / number,
            false => number,
        }
    }

    /// A number of the diagonal of J_pᵀJ_p, from that of V = LLᵀ with damping `lambda`.
    #[inline]
    pub(crate) fn diagonal(&self, k: usize, lambda: f64) -> f64 {
        let (before, inverse) = (&self.factor[row(k)..][..k], self.factor[row(k) + k]);
        if inverse == 0.0 {
            return 0.0;
        }
        before.iter().fold(1.0 / (inverse * inverse), |sum, l| sum + l * l) / (1.0 + lambda)
    }
}

/// What the stash holds before Y, as far as elimination needs it, in registers.
struct Head<const P: usize> {
    factor: [[f64; P]; P],
    y: [f64; P],
    inverse: [f64; P],
}

impl<const P: usize> Head<P> {
    #[inline(always)]
    fn of(head: &[f64]) -> Self {
        let mut this = Self { factor: [[0.0; P]; P], y: [0.0; P], inverse: [0.0; P] };
        for i in 0..P {
            for j in 0..i {
                this.factor[i][j] = head[row(i) + j];
            }
            this.inverse[i] = head[row(i) + i];
            this.y[i] = head[row(P) + i];
        }
        this
    }
}

/// λD of a direction with this entry on the diagonal of JᵀJ: Marquardt's scaling, which makes the step independent of units. A
/// direction that no factor sees gets a one for now, and stays where it is.
#[inline(always)]
pub(crate) fn damping(diagonal: f64, lambda: f64) -> f64 {
    if diagonal > 0.0 { lambda * diagonal } else { 1.0 }
}
