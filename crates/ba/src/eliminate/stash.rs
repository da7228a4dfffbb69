//! What the elimination leaves of a cell, as it is written and as it is read.

use super::multiply::{multiply, multiply_transposed};
use super::product::over_lanes;
use super::simd::{Isa, Stored, Vector, WIDE};
use crate::structure::{Cell, Chunk, Elimination, Local, padded, row, stash_head, stash_len};

/// The parts of a cell's stash.
pub(crate) struct CellStash<'a> {
    /// The lower triangle of L, row by row, with the inverses of its diagonal; 0 there for a
    /// direction that no factor sees.
    pub(super) factor: &'a [f64],
    /// y.
    pub(super) reduced_gradient: &'a [f64],
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
            Self::Single(y) => multiply(y, locals, kept, step),
            Self::Double(y) => multiply(y, locals, kept, step),
        }
    }

    /// kept += Yᵀ u.
    pub(crate) fn multiply_transposed(self, locals: &[Local], u: &[f64], kept: &mut [f64]) {
        match self {
            Self::Single(y) => multiply_transposed(y, locals, u, kept),
            Self::Double(y) => multiply_transposed(y, locals, u, kept),
        }
    }
}

impl<'a> CellStash<'a> {
    /// In the memory of all chunks.
    pub(crate) fn of(memory: &'a [f64], cell: &Cell, chunk: &Chunk) -> Self {
        let p = cell.dof as usize;
        let dense = chunk.patterns.of(cell).dense;
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
pub(super) struct Head<const P: usize> {
    pub(super) factor: [[f64; P]; P],
    pub(super) y: [f64; P],
    pub(super) inverse: [f64; P],
}

impl<const P: usize> Head<P> {
    #[inline(always)]
    pub(super) fn of(head: &[f64]) -> Self {
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

/// Copies Yᵀ of a cell's blocks, whose rows are `width` apart, to its stash. Vectors overlap what
/// comes next, which is therefore written later.
#[inline(always)]
pub(super) fn stash_rows<const P: usize, I: Isa, const D: usize>(
    w: &[f64],
    width: usize,
    locals: &[Local],
    stash: &mut [f64],
    elimination: Elimination,
) {
    if elimination == Elimination::Implicit {
        stash_rows_as::<P, I, f64, D>(w, width, locals, stash);
    } else {
        stash_rows_as::<P, I, f32, D>(w, width, locals, bytemuck::cast_slice_mut(stash));
    }
}

#[inline(always)]
fn stash_rows_as<const P: usize, I: Isa, T: Stored, const D: usize>(
    w: &[f64],
    width: usize,
    locals: &[Local],
    stash: &mut [T],
) {
    for local in locals {
        let dof = local.dof_or::<D>();
        let lanes = padded(dof);
        for k in 0..P {
            let from = &w[k * width + local.column..][..lanes];
            let to = &mut stash[P * local.dense + k * dof..][..lanes];
            over_lanes!(lanes, copy::<I, T>(from, to));
        }
    }
}

#[inline(always)]
fn copy<V: Vector, T: Stored>(lane: usize, from: &[f64], to: &mut [T]) {
    T::store(V::load(&from[lane..]), &mut to[lane..]);
}
