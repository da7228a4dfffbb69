//! The elimination of any cell: factors of any shape, that may share blocks or see parts of them.
// One index runs through several arrays, and closures are not compiled for the instruction set.
#![allow(clippy::needless_range_loop)]

use super::cursor::At;
use super::product::{Of, SumProduct, over_lanes};
use super::simd::{Isa, Task, Vector, WIDE};
use super::stash::{Head, stash_rows};
use super::workspace::{Room, SLACK};
use crate::structure::{Cell, Chunk, Elimination, Local, Shape, stash_head, stash_len};

/// Subtracts YᵀY and Yᵀy of cells with the same pattern, of which `own_block` has been called.
///
/// With Z = J_p L⁻ᵀ of one factor, rows of P numbers, Y is the sum of ZᵀJ_c over the factors.
pub(super) struct Eliminate<'a, 'r, const P: usize> {
    pub(super) room: &'a mut Room<'r>,
    pub(super) chunk: &'a Chunk,
    pub(super) cells: &'a [Cell],
    pub(super) at: &'a mut At,
}

impl<const P: usize> Task for Eliminate<'_, '_, P> {
    #[inline(always)]
    fn run<I: Isa>(self) {
        let Self { room, chunk, cells, at } = self;
        let pattern = chunk.patterns.of(&cells[0]);
        let locals = chunk.patterns.locals_of(&cells[0]);
        let width = pattern.width;
        if locals.is_empty() {
            return at.skip(chunk, cells);
        }
        let Room { tiles, vectors, stash, rows, w, y, .. } = room;
        let w = &mut w[..cells.len() * P * width];
        let y = &mut y[..cells.len() * P];
        w.fill(0.0);
        for ((cell, w), y) in
            cells.iter().zip(w.chunks_exact_mut(P * width)).zip(y.chunks_exact_mut(P))
        {
            let (head, stashed) = stash[cell.stash..]
                [..stash_len(P, pattern.dense, chunk.elimination)]
                .split_at_mut(stash_head(P));
            let head = Head::<P>::of(head);
            y.copy_from_slice(&head.y);
            let mut coupling = Coupling { locals, head: &head, y: w, width };
            while at.factor < cell.end as usize {
                let shape = chunk.factors.shape(at.factor);
                at.factor += 1;
                let these = &chunk.factors.locals[at.local..][..shape.segments.len()];
                at.local += these.len();
                let len = shape.rows * shape.stride;
                // The slack behind the buffer lets loads of whole vectors reach beyond the last
                // row.
                let rows = &rows[at.row..][..len + SLACK];
                at.row += len;
                // Two rows at a time: a reprojection has two.
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
            stash_rows::<P, I, 0>(coupling.y, width, locals, stashed, chunk.elimination);
        }
        let (w, y) = (&*w, &*y);
        for local in locals {
            let correction = &mut vectors[3 * local.at + local.padded..][..local.padded];
            over_lanes!(local.padded, correct::<I>(w, width, local.column, y, correction));
        }
        if chunk.elimination == Elimination::Implicit {
            return;
        }
        let mut pairs = chunk.patterns.pair_tiles[pattern.pairs..].iter();
        for (l, b) in locals.iter().enumerate() {
            let b = Of { column: b.column, dof: b.dof };
            for (a, &at) in locals[..=l].iter().zip(pairs.by_ref()) {
                let a = Of { column: a.column, dof: a.dof };
                let tile = &mut tiles[at as usize..];
                I::run(SumProduct::<_, false> { rows: w.chunks_exact(width), a, b, tile });
            }
        }
    }
}

/// Y of a cell, in rows over its pattern's blocks that are `width` apart.
struct Coupling<'a, const P: usize> {
    locals: &'a [Local],
    head: &'a Head<P>,
    y: &'a mut [f64],
    width: usize,
}

impl<const P: usize> Coupling<'_, P> {
    /// Adds `R` rows of one factor, of which `these` are the blocks of its segments.
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
            let local = &self.locals[l as usize];
            let mut these_rows = rows;
            for row in &mut these_rows {
                *row = &row[segment.column..];
            }
            if segment.whole {
                let y = &mut self.y[local.column..];
                over_lanes!(local.padded, add_to_y::<I, R, P>(&these_rows, &z, y, self.width));
            } else {
                for r in 0..R {
                    for i in 0..segment.dof {
                        for k in 0..P {
                            let y = &mut self.y[k * self.width + local.column + segment.offset + i];
                            *y = I::mul_add_one(z[r][k], these_rows[r][i], *y);
                        }
                    }
                }
            }
        }
    }
}

/// The part of `R` rows of a factor in one block's Y.
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

/// Yᵀy of one block, over all cells.
#[inline(always)]
fn correct<V: Vector>(
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
