//! The elimination of any cell: factors of any shape, that may share blocks or see parts of them.
#![allow(clippy::needless_range_loop)] // one index runs through several arrays, and closures are not compiled for the instruction set

use super::kernel::{At, SLACK, stash_rows};
use super::lanes::{Isa, Vector, WIDE};
use super::product::{over_lanes, product};
use super::{Head, Room, stash_head, stash_len};
use crate::structure::{Cell, Chunk, Elimination, Local, Shape, tile_index};

/// Adds one cell, of which `own_block` has been called, to the sums.
#[inline(always)]
pub(super) fn eliminate<const P: usize, I: Isa>(
    room: &mut Room<'_>,
    chunk: &Chunk,
    cell: &Cell,
    at: &mut At,
) {
    let pattern = &chunk.patterns[cell.pattern as usize];
    let locals = &chunk.pattern_locals[pattern.locals.clone()];
    let pairs = &chunk.pair_tiles[pattern.pairs..][..locals.len() * (locals.len() + 1) / 2];
    let width = pattern.width;
    let Room { tiles, vectors, stash, rows, w, .. } = room;
    let w = &mut w[..P * width];
    w.fill(0.0);

    while at.factor < cell.end as usize {
        let shape = &chunk.shapes[chunk.shape_of[at.factor] as usize];
        at.factor += 1;
        let these = &chunk.locals[at.local..][..shape.segments.len()];
        at.local += these.len();
        let len = shape.rows * shape.stride;
        // The slack behind the buffer lets loads of whole vectors reach beyond the last row.
        let rows = &rows[at.row..][..len + SLACK];
        at.row += len;
        // Two rows at a time: a reprojection has two.
        let mut row = 0;
        while row < shape.rows {
            let rows = &rows[row * shape.stride..];
            if row + 1 < shape.rows {
                let rows = [rows, &rows[shape.stride..]];
                add_rows::<2, P, I>(rows, shape, these, locals, pairs, tiles, vectors, w, width);
            } else {
                add_rows::<1, P, I>([rows], shape, these, locals, pairs, tiles, vectors, w, width);
            }
            row += 2;
        }
    }
    if P == 0 {
        return;
    }

    let (head, stashed) =
        stash[cell.stash..][..stash_len(P, pattern.dense, chunk.elimination)].split_at_mut(stash_head(P));
    let head = Head::<P>::of(head);
    for b in locals {
        over_lanes!(b.padded, whiten::<I, P>(b.column, w, width, &head));
    }
    let w = &*w;
    stash_rows::<P, I, 0>(w, width, locals, stashed, chunk.elimination);
    let mut pair = pairs.iter();
    for b in locals {
        let mut rows_b = [&[][..]; P];
        for k in 0..P {
            rows_b[k] = &w[k * width + b.column..][..b.padded];
        }
        let correction = &mut vectors[3 * b.at + b.padded..][..b.padded];
        over_lanes!(b.padded, correct::<I, P>(&head.y, &rows_b, correction));
        if chunk.elimination == Elimination::Implicit {
            continue;
        }
        for (a, &at) in locals.iter().zip(pair.by_ref()) {
            let mut rows_a = [&[][..]; P];
            for k in 0..P {
                rows_a[k] = &w[k * width + a.column..][..a.padded];
            }
            product::<I, P, false>(&rows_a, &rows_b, a.dof, b.dof, &mut tiles[at as usize..]);
            if a.at == b.at {
                break;
            }
        }
    }
}

/// Adds `R` rows of one factor to the gradient, the diagonal, W and the tiles.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "one step of one loop, apart only to be compiled for each R")]
fn add_rows<const R: usize, const P: usize, I: Isa>(
    rows: [&[f64]; R],
    shape: &Shape,
    these: &[u16],
    locals: &[Local],
    pairs: &[u32],
    tiles: &mut [f64],
    vectors: &mut [f64],
    w: &mut [f64],
    width: usize,
) {
    let mut jp = [[0.0; P]; R];
    let mut residual = [0.0; R];
    for r in 0..R {
        jp[r] = *rows[r][shape.eliminated..].first_chunk().expect("rows hold the eliminated variable");
        residual[r] = rows[r][shape.residual];
    }
    for (s, (segment, &l)) in shape.segments.iter().zip(these).enumerate() {
        let local = &locals[l as usize];
        let padded = local.padded;
        let (gradient, rest) = vectors[3 * local.at..][..3 * padded].split_at_mut(padded);
        let diagonal = &mut rest[padded..];
        if segment.whole {
            // Where nothing is eliminated there is no W.
            let w = if P == 0 { &mut [][..] } else { &mut w[local.column..] };
            let mut these_rows = rows;
            for row in &mut these_rows {
                *row = &row[segment.column..];
            }
            over_lanes!(
                padded,
                add_to_vectors::<I, R, P>(&these_rows, &jp, &residual, gradient, diagonal, w, width)
            );
        } else {
            for r in 0..R {
                let j = &rows[r][segment.column..][..segment.dof];
                for (i, j) in j.iter().enumerate() {
                    let at = segment.offset + i;
                    gradient[at] = I::mul_add_one(*j, residual[r], gradient[at]);
                    diagonal[at] = I::mul_add_one(*j, *j, diagonal[at]);
                    for k in 0..P {
                        let w = &mut w[k * width + local.column + at];
                        *w = I::mul_add_one(jp[r][k], *j, *w);
                    }
                }
            }
        }
        for (other, &m) in shape.segments[..=s].iter().zip(these) {
            let (lo, hi) = if m <= l { (m, l) } else { (l, m) };
            let (a, b) =
                if (m, other.offset) <= (l, segment.offset) { (other, segment) } else { (segment, other) };
            let at = pairs[hi as usize * (hi as usize + 1) / 2 + lo as usize] as usize;
            let (dof_a, dof_b) = (locals[lo as usize].dof, locals[hi as usize].dof);
            let tile = &mut tiles[at..];
            if a.whole && b.whole {
                let (mut rows_a, mut rows_b) = ([&[][..]; R], [&[][..]; R]);
                for r in 0..R {
                    rows_a[r] = &rows[r][a.column..];
                    rows_b[r] = &rows[r][b.column..];
                }
                product::<I, R, true>(&rows_a, &rows_b, dof_a, dof_b, tile);
                continue;
            }
            for j in 0..a.dof {
                for i in 0..b.dof {
                    let to = &mut tile[tile_index(dof_a, dof_b, a.offset + j, b.offset + i)];
                    for r in 0..R {
                        *to = I::mul_add_one(rows[r][a.column + j], rows[r][b.column + i], *to);
                    }
                }
            }
        }
    }
}

/// The part of `R` rows of a factor in one block's gradient, diagonal and W.
#[inline(always)]
#[expect(
    clippy::too_many_arguments,
    reason = "one step of one loop, apart only to be compiled for each vector"
)]
fn add_to_vectors<V: Vector, const R: usize, const P: usize>(
    lane: usize,
    rows: &[&[f64]; R],
    jp: &[[f64; P]; R],
    residual: &[f64; R],
    gradient: &mut [f64],
    diagonal: &mut [f64],
    w: &mut [f64],
    width: usize,
) {
    let mut j = [V::splat(0.0); R];
    for r in 0..R {
        j[r] = V::load(&rows[r][lane..]);
    }
    let (mut g, mut d) = (V::load(&gradient[lane..]), V::load(&diagonal[lane..]));
    for r in 0..R {
        g = j[r].mul_add(V::splat(residual[r]), g);
        d = j[r].mul_add(j[r], d);
    }
    g.store(&mut gradient[lane..]);
    d.store(&mut diagonal[lane..]);
    for k in 0..P {
        let w = &mut w[k * width + lane..];
        let mut sum = V::load(w);
        for r in 0..R {
            sum = V::splat(jp[r][k]).mul_add(j[r], sum);
        }
        sum.store(w);
    }
}

/// Y = L⁻¹W from `column` on: `w` holds Wᵀ row by row, and Y is written there.
#[inline(always)]
fn whiten<V: Vector, const P: usize>(
    lane: usize,
    column: usize,
    w: &mut [f64],
    width: usize,
    head: &Head<P>,
) {
    let mut rows = [V::splat(0.0); P];
    for k in 0..P {
        let at = k * width + column + lane;
        let row = &mut w[at..];
        let mut sum = V::load(row);
        for i in 0..k {
            sum = V::splat(head.factor[k][i]).neg_mul_add(rows[i], sum);
        }
        rows[k] = sum.mul(V::splat(head.inverse[k]));
        rows[k].store(row);
    }
}

/// Yᵀy of one block.
#[inline(always)]
fn correct<V: Vector, const P: usize>(lane: usize, y: &[f64; P], rows: &[&[f64]; P], correction: &mut [f64]) {
    let mut sum = V::load(&correction[lane..]);
    for k in 0..P {
        sum = V::splat(y[k]).mul_add(V::load(&rows[k][lane..]), sum);
    }
    sum.store(&mut correction[lane..]);
}
