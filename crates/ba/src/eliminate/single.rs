//! Elimination of a point that each camera sees once, where cameras share no parameters: most of
//! the work of most bundle adjustments. Each factor has two rows, and each column block of the
//! landmark block belongs to one factor. The sums that [`general`](super::general) keeps in memory
//! stay in registers here.
// One index runs through several arrays. Closures are not compiled for the instruction set.
#![allow(clippy::needless_range_loop)]

use super::cursor::Cursor;
use super::product::{ColumnSpan, POINT as P, over_lanes, product, sum_product};
use super::simd::{Isa, Kernel, Vector, WIDE};
use super::stash::{StashHead, stash_rows};
use super::workspace::{SLACK, Workspace};
use crate::structure::{
    Elimination, LandmarkBlock, SINGLE_ROWS as ROWS, Task, padded, pair, stash_head, stash_len,
};

/// Adds landmark blocks with the same pattern to the task's sums, after `factorise_landmark`, with
/// one product for all of them. `D` is the size of all their column blocks as a constant, or 0.
///
/// With Z = J_p L⁻ᵀ of one factor (two rows of P numbers), Y = ZᵀJ_c, and the factor's part of C −
/// YᵀY is J_cᵀ (I − ZZᵀ) J_c: two products of rows instead of the five of J_cᵀJ_c and YᵀY.
pub(super) struct Eliminate<'a, 'r, const D: usize> {
    pub(super) workspace: &'a mut Workspace<'r>,
    pub(super) task: &'a Task,
    pub(super) landmarks: &'a [LandmarkBlock],
    pub(super) cursor: &'a mut Cursor,
}

impl<const D: usize> Kernel for Eliminate<'_, '_, D> {
    #[inline(always)]
    fn run<I: Isa>(self) {
        let Self { workspace, task, landmarks, cursor } = self;
        let pattern = task.patterns.of(&landmarks[0]);
        let pattern_blocks = task.patterns.blocks_of(&landmarks[0]);
        let pairs = &task.patterns.pair_tiles[pattern.pairs..]
            [..pattern_blocks.len() * (pattern_blocks.len() + 1) / 2];
        let width = pattern.padded_width;
        let Workspace { tiles, vectors, stash, rows, w, projected, .. } = workspace;
        let w = &mut w[..landmarks.len() * P * width];
        for (landmark, w) in landmarks.iter().zip(w.chunks_exact_mut(P * width)) {
            let (head, stashed) = stash[landmark.stash..]
                [..stash_len(P, pattern.packed_width, task.elimination)]
                .split_at_mut(stash_head(P));
            let head = StashHead::<P>::of(head);
            let factors = cursor.factor..landmark.end as usize;
            cursor.factor = factors.end;
            let these = &task.factors.block_indices[cursor.block_index..][..factors.len()];
            cursor.block_index += these.len();
            for (&shape, &l) in task.factors.shape_of[factors].iter().zip(these) {
                let shape = &task.factors.shapes[shape as usize];
                let pattern_block = &pattern_blocks[l as usize];
                let dof = pattern_block.dof_or::<D>();
                let lanes = padded(dof);
                // The slack behind the buffer lets vector loads reach beyond the last row.
                let both = &rows[cursor.row..][..ROWS * shape.stride + SLACK];
                cursor.row += ROWS * shape.stride;
                let mut rows = [&[][..]; ROWS];
                let (mut z, mut residual) = ([[0.0; P]; ROWS], [0.0; ROWS]);
                for r in 0..ROWS {
                    let row = &both[r * shape.stride..];
                    rows[r] = &row[shape.segments[0].column..][..lanes];
                    residual[r] = row[shape.residual];
                    z[r] = *row[shape.eliminated..]
                        .first_chunk()
                        .expect("rows hold the eliminated variable");
                }
                let factor = Factor::new::<I>(rows, z, residual, &head, task.elimination);
                let projected = &mut projected[..ROWS * lanes];
                let mut block = BlockSums {
                    lanes,
                    vectors: &mut vectors[3 * pattern_block.vector_offset..][..3 * lanes],
                    y: &mut w[pattern_block.padded_offset..][..(P - 1) * width + lanes],
                    width,
                    projected,
                };
                over_lanes!(lanes, add_block::<I>(&factor, &mut block));
                let at = pairs[pair(pattern_blocks.len(), l as usize, l as usize)] as usize;
                let projected = [&projected[..lanes], &projected[lanes..]];
                product::<I, ROWS>(&rows, &projected, dof, dof, &mut tiles[at..]);
            }
            stash_rows::<P, I, D>(w, width, pattern_blocks, stashed, task.elimination);
        }
        if task.elimination == Elimination::Implicit {
            return;
        }
        let mut first = 0;
        for (l, a) in pattern_blocks.iter().enumerate() {
            let a = ColumnSpan { column: a.padded_offset, dof: a.dof_or::<D>() };
            // A block with itself, the first pair, is done above.
            for (b, &at) in pattern_blocks[l..].iter().zip(&pairs[first..]).skip(1) {
                let b = ColumnSpan { column: b.padded_offset, dof: b.dof_or::<D>() };
                sum_product::<I, false>(w.chunks_exact(width), a, b, &mut tiles[at as usize..]);
            }
            first += pattern_blocks.len() - l;
        }
    }
}

/// One factor.
struct Factor<'a> {
    /// J_c.
    rows: [&'a [f64]; ROWS],
    residual: [f64; ROWS],
    z: [[f64; P]; ROWS],
    /// I − ZZᵀ; I for the implicit solver, which subtracts nothing.
    rest: [[f64; ROWS]; ROWS],
    /// Zy.
    corrected: [f64; ROWS],
}

impl<'a> Factor<'a> {
    /// `z` is J_p.
    #[inline(always)]
    fn new<I: Isa>(
        rows: [&'a [f64]; ROWS],
        mut z: [[f64; P]; ROWS],
        residual: [f64; ROWS],
        head: &StashHead<P>,
        elimination: Elimination,
    ) -> Self {
        let mut corrected = [0.0; ROWS];
        for r in 0..ROWS {
            for k in 0..P {
                for i in 0..k {
                    z[r][k] = I::mul_add_one(-head.factor[k][i], z[r][i], z[r][k]);
                }
                z[r][k] *= head.inverse[k];
                corrected[r] = I::mul_add_one(z[r][k], head.y[k], corrected[r]);
            }
        }
        let mut rest = [[1.0, 0.0], [0.0, 1.0]];
        if elimination != Elimination::Implicit {
            for r in 0..ROWS {
                for s in 0..=r {
                    for k in 0..P {
                        rest[r][s] = I::mul_add_one(-z[r][k], z[s][k], rest[r][s]);
                    }
                    rest[s][r] = rest[r][s];
                }
            }
        }
        Self { rows, residual, z, rest, corrected }
    }
}

/// Results of one factor for its column block.
struct BlockSums<'a> {
    lanes: usize,
    /// Gradient, correction and diagonal.
    vectors: &'a mut [f64],
    /// Rows that are `width` apart.
    y: &'a mut [f64],
    width: usize,
    /// (I − ZZᵀ) J_c.
    projected: &'a mut [f64],
}

/// One vector of the gradient, the correction, the diagonal, Y and (I − ZZᵀ) J_c of one block.
#[inline(always)]
fn add_block<V: Vector>(lane: usize, factor: &Factor<'_>, block: &mut BlockSums<'_>) {
    let BlockSums { lanes, width, .. } = *block;
    let BlockSums { vectors, y, projected, .. } = block;
    let mut j = [V::splat(0.0); ROWS];
    for r in 0..ROWS {
        j[r] = V::load(&factor.rows[r][lane..]);
    }
    for k in 0..P {
        let mut sum = j[0].mul(V::splat(factor.z[0][k]));
        for r in 1..ROWS {
            sum = j[r].mul_add(V::splat(factor.z[r][k]), sum);
        }
        sum.store(&mut y[k * width + lane..]);
    }
    for s in 0..ROWS {
        let mut sum = j[0].mul(V::splat(factor.rest[s][0]));
        for r in 1..ROWS {
            sum = j[r].mul_add(V::splat(factor.rest[s][r]), sum);
        }
        sum.store(&mut projected[s * lanes + lane..]);
    }
    let mut g = V::load(&vectors[lane..]);
    let mut c = V::load(&vectors[lanes + lane..]);
    let mut d = V::load(&vectors[2 * lanes + lane..]);
    for r in 0..ROWS {
        g = j[r].mul_add(V::splat(factor.residual[r]), g);
        c = j[r].mul_add(V::splat(factor.corrected[r]), c);
        d = j[r].mul_add(j[r], d);
    }
    g.store(&mut vectors[lane..]);
    c.store(&mut vectors[lanes + lane..]);
    d.store(&mut vectors[2 * lanes + lane..]);
}
