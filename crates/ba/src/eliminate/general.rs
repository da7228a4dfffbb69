//! Elimination of any landmark block: factors of any shape, which may share column blocks or have
//! parts of them.
// One index runs through several arrays. Closures are not compiled for the instruction set.
#![allow(clippy::needless_range_loop)]

use super::cursor::Cursor;
use super::product::{SubtractProducts, over_lanes};
use super::simd::{Isa, Kernel, Vector, WIDE};
use super::stash::{StashHead, stash_rows};
use super::workspace::{SLACK, Workspace};
use crate::structure::{
    Elimination, LandmarkBlock, PatternBlock, Shape, Task, stash_head, stash_len,
};

/// Subtracts YᵀY and Yᵀy of landmark blocks with the same pattern, after `factorise_landmark`.
///
/// With Z = J_p L⁻ᵀ (rows of P numbers) of one factor, Y is the sum of ZᵀJ_c over the factors.
pub(super) struct Eliminate<'a, 'r, const P: usize> {
    pub(super) workspace: &'a mut Workspace<'r>,
    pub(super) task: &'a Task,
    pub(super) landmarks: &'a [LandmarkBlock],
    pub(super) cursor: &'a mut Cursor,
}

impl<const P: usize> Kernel for Eliminate<'_, '_, P> {
    #[inline(always)]
    fn run<I: Isa>(self) {
        let Self { workspace, task, landmarks, cursor } = self;
        let pattern = task.patterns.of(&landmarks[0]);
        let pattern_blocks = task.patterns.blocks_of(&landmarks[0]);
        let width = pattern.padded_width;
        if pattern_blocks.is_empty() {
            return cursor.skip(task, landmarks);
        }
        let Workspace { tiles, vectors, stash, rows, w, y, .. } = workspace;
        let w = &mut w[..landmarks.len() * P * width];
        let y = &mut y[..landmarks.len() * P];
        w.fill(0.0);
        for ((landmark, w), y) in
            landmarks.iter().zip(w.chunks_exact_mut(P * width)).zip(y.chunks_exact_mut(P))
        {
            let (head, stashed) = stash[landmark.stash..]
                [..stash_len(P, pattern.packed_width, task.elimination)]
                .split_at_mut(stash_head(P));
            let head = StashHead::<P>::of(head);
            y.copy_from_slice(&head.y);
            let mut coupling = Coupling { pattern_blocks, head: &head, y: w, width };
            while cursor.factor < landmark.end as usize {
                let shape = task.factors.shape(cursor.factor);
                cursor.factor += 1;
                let these =
                    &task.factors.block_indices[cursor.block_index..][..shape.segments.len()];
                cursor.block_index += these.len();
                let len = shape.rows * shape.stride;
                // The slack behind the buffer lets vector loads reach beyond the last row.
                let rows = &rows[cursor.row..][..len + SLACK];
                cursor.row += len;
                // Two rows at a time, because a reprojection has two.
                let mut row = 0;
                while row < shape.rows {
                    let rows = &rows[row * shape.stride..];
                    if row + 1 < shape.rows {
                        coupling.add_rows::<2, I>([rows, &rows[shape.stride..]], shape, these);
                    } else {
                        coupling.add_rows::<1, I>([rows], shape, these);
                    }
                    row += 2;
                }
            }
            stash_rows::<P, I, 0>(coupling.y, width, pattern_blocks, stashed, task.elimination);
        }
        let (w, y) = (&*w, &*y);
        for pattern_block in pattern_blocks {
            let correction = &mut vectors[3 * pattern_block.vector_offset + pattern_block.padded..]
                [..pattern_block.padded];
            over_lanes!(
                pattern_block.padded,
                add_gradient_correction::<I>(w, width, pattern_block.padded_offset, y, correction)
            );
        }
        if task.elimination == Elimination::Implicit {
            return;
        }
        let mut pairs = &task.patterns.pair_tiles[pattern.pairs..];
        for l in 0..pattern_blocks.len() {
            let blocks = &pattern_blocks[l..];
            let (tile_at, rest) = pairs.split_at(blocks.len());
            pairs = rest;
            I::run(SubtractProducts { y: w, width, blocks, tile_at, tiles });
        }
    }
}

/// Y of a landmark: rows over its pattern's blocks, `width` apart.
struct Coupling<'a, const P: usize> {
    pattern_blocks: &'a [PatternBlock],
    head: &'a StashHead<P>,
    y: &'a mut [f64],
    width: usize,
}

impl<const P: usize> Coupling<'_, P> {
    /// Adds `R` rows of one factor. `these` are the pattern's block indices of its segments.
    #[inline(always)]
    fn add_rows<const R: usize, I: Isa>(
        &mut self,
        rows: [&[f64]; R],
        shape: &Shape,
        these: &[u16],
    ) {
        let mut z = [[0.0; P]; R];
        for r in 0..R {
            z[r] = *rows[r][shape.eliminated..]
                .first_chunk()
                .expect("rows hold the eliminated variable");
            for k in 0..P {
                for i in 0..k {
                    z[r][k] = I::mul_add_one(-self.head.factor[k][i], z[r][i], z[r][k]);
                }
                z[r][k] *= self.head.inverse[k];
            }
        }
        for (segment, &l) in shape.segments.iter().zip(these) {
            let pattern_block = &self.pattern_blocks[l as usize];
            let mut these_rows = rows;
            for row in &mut these_rows {
                *row = &row[segment.column..];
            }
            if segment.whole {
                let y = &mut self.y[pattern_block.padded_offset..];
                over_lanes!(
                    pattern_block.padded,
                    add_to_y::<I, R, P>(&these_rows, &z, y, self.width)
                );
            } else {
                for r in 0..R {
                    for i in 0..segment.dof {
                        for k in 0..P {
                            let y = &mut self.y
                                [k * self.width + pattern_block.padded_offset + segment.offset + i];
                            *y = I::mul_add_one(z[r][k], these_rows[r][i], *y);
                        }
                    }
                }
            }
        }
    }
}

/// Adds ZᵀJ_c of `R` rows of a factor to one block of Y.
#[inline(always)]
fn add_to_y<V: Vector, const R: usize, const P: usize>(
    lane: usize,
    rows: &[&[f64]; R],
    z: &[[f64; P]; R],
    w: &mut [f64],
    width: usize,
) {
    let mut j = [V::splat(0.0); R];
    for r in 0..R {
        j[r] = V::load(&rows[r][lane..]);
    }
    for k in 0..P {
        let w = &mut w[k * width + lane..];
        let mut sum = V::load(w);
        for r in 0..R {
            sum = V::splat(z[r][k]).mul_add(j[r], sum);
        }
        sum.store(w);
    }
}

/// Adds Yᵀy of one landmark and one block to `correction`, which is subtracted from the reduced
/// gradient. `w` is Y, `width` numbers for each direction of the landmark; the block begins at
/// `column`.
#[inline(always)]
fn add_gradient_correction<V: Vector>(
    lane: usize,
    w: &[f64],
    width: usize,
    column: usize,
    y: &[f64],
    correction: &mut [f64],
) {
    let mut sum = V::load(&correction[lane..]);
    for (row, y) in w.chunks_exact(width).zip(y) {
        sum = V::splat(*y).mul_add(V::load(&row[column + lane..]), sum);
    }
    sum.store(&mut correction[lane..]);
}
