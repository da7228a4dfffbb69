//! Results of elimination that back-substitution reads.

use super::multiply::{multiply, multiply_transposed};
use super::product::over_lanes;
use super::simd::{Isa, Stored, Vector, WIDE};
use crate::structure::{
    Elimination, LandmarkBlock, PatternBlock, Task, padded, stash_head, stash_len, triangle_row,
};

/// Views of a landmark's stash.
pub(crate) struct LandmarkStash<'a> {
    /// Lower triangle of L, row by row, with the inverse of its diagonal. That inverse is 0 for a
    /// direction that no factor depends on.
    pub(super) factor: &'a [f64],
    /// y.
    pub(super) reduced_gradient: &'a [f64],
    pub(crate) y: Y<'a>,
}

/// Y: for each of the pattern's blocks, one row for each direction of the landmark.
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

    /// step += Y δ_c. `kept` holds δ_c over the task's blocks, with zeros in the padding.
    pub(crate) fn multiply(self, pattern_blocks: &[PatternBlock], kept: &[f64], step: &mut [f64]) {
        match self {
            Self::Single(y) => multiply(y, pattern_blocks, kept, step),
            Self::Double(y) => multiply(y, pattern_blocks, kept, step),
        }
    }

    /// kept += Yᵀ u.
    pub(crate) fn multiply_transposed(
        self,
        pattern_blocks: &[PatternBlock],
        u: &[f64],
        kept: &mut [f64],
    ) {
        match self {
            Self::Single(y) => multiply_transposed(y, pattern_blocks, u, kept),
            Self::Double(y) => multiply_transposed(y, pattern_blocks, u, kept),
        }
    }
}

impl<'a> LandmarkStash<'a> {
    /// Stash of a landmark in `memory`, which holds that of all tasks.
    pub(crate) fn of(memory: &'a [f64], landmark: &LandmarkBlock, task: &Task) -> Self {
        let p = landmark.dof as usize;
        let dense = task.patterns.of(landmark).packed_width;
        let (head, y) = memory[task.memory.start + task.tiles_len + landmark.stash..]
            [..stash_len(p, dense, task.elimination)]
            .split_at(stash_head(p));
        let y = match task.elimination {
            Elimination::Implicit => Y::Double(y),
            _ => Y::Single(bytemuck::cast_slice(y)),
        };
        let (factor, reduced_gradient) = head.split_at(triangle_row(p));
        Self { factor, reduced_gradient, y }
    }

    /// Element of L's lower triangle. The diagonal is 1 for a direction that no factor depends on.
    pub(crate) fn factor(&self, i: usize, j: usize) -> f64 {
        let number = self.factor[triangle_row(i) + j];
        match i == j {
            true if number == 0.0 => 1.0,
            true => 1.0 / number,
            false => number,
        }
    }

    /// Diagonal element k of J_pᵀJ_p, computed from V = LLᵀ with damping `lambda`.
    #[inline]
    pub(crate) fn diagonal(&self, k: usize, lambda: f64) -> f64 {
        let (before, inverse) =
            (&self.factor[triangle_row(k)..][..k], self.factor[triangle_row(k) + k]);
        if inverse == 0.0 {
            return 0.0;
        }
        before.iter().fold(1.0 / (inverse * inverse), |sum, l| sum + l * l) / (1.0 + lambda)
    }
}

/// The part of a stash before Y.
pub(super) struct StashHead<const P: usize> {
    pub(super) factor: [[f64; P]; P],
    pub(super) y: [f64; P],
    pub(super) inverse: [f64; P],
}

impl<const P: usize> StashHead<P> {
    #[inline(always)]
    pub(super) fn of(head: &[f64]) -> Self {
        let mut this = Self { factor: [[0.0; P]; P], y: [0.0; P], inverse: [0.0; P] };
        for i in 0..P {
            for j in 0..i {
                this.factor[i][j] = head[triangle_row(i) + j];
            }
            this.inverse[i] = head[triangle_row(i) + i];
            this.y[i] = head[triangle_row(P) + i];
        }
        this
    }
}

/// Copies Y of a landmark, block by block and without padding, to its stash. Vector stores overlap
/// the next row, which is therefore written later.
#[inline(always)]
pub(super) fn stash_rows<const P: usize, I: Isa, const D: usize>(
    w: &[f64],
    width: usize,
    pattern_blocks: &[PatternBlock],
    stash: &mut [f64],
    elimination: Elimination,
) {
    if elimination == Elimination::Implicit {
        stash_rows_as::<P, I, f64, D>(w, width, pattern_blocks, stash);
    } else {
        stash_rows_as::<P, I, f32, D>(w, width, pattern_blocks, bytemuck::cast_slice_mut(stash));
    }
}

#[inline(always)]
fn stash_rows_as<const P: usize, I: Isa, T: Stored, const D: usize>(
    w: &[f64],
    width: usize,
    pattern_blocks: &[PatternBlock],
    stash: &mut [T],
) {
    for pattern_block in pattern_blocks {
        let dof = pattern_block.dof_or::<D>();
        let lanes = padded(dof);
        for k in 0..P {
            let from = &w[k * width + pattern_block.padded_offset..][..lanes];
            let to = &mut stash[P * pattern_block.packed_offset + k * dof..][..lanes];
            over_lanes!(lanes, copy::<I, T>(from, to));
        }
    }
}

#[inline(always)]
fn copy<V: Vector, T: Stored>(lane: usize, from: &[f64], to: &mut [T]) {
    T::store(V::load(&from[lane..]), &mut to[lane..]);
}
