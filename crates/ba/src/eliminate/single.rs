//! The elimination of a point that is seen once by each of some cameras, with nothing that these share: the bulk of most
//! bundle adjustments. Then each factor has two rows, each of its cell's blocks belongs to one factor, and what
//! [`cell`](super::cell) sums up in memory stays in registers.
#![allow(clippy::needless_range_loop)] // one index runs through several arrays, and closures are not compiled for the instruction set

use super::kernel::{At, SLACK, stash_rows};
use super::lanes::{Isa, Vector, WIDE};
use super::product::{Of, over_lanes, product, product_of_two, subtract_product};
use super::{Head, Room, stash_head, stash_len};
use crate::structure::{Cell, Chunk, Elimination, Local};

/// Degrees of freedom of a point.
const P: usize = 3;
/// Rows of a factor.
pub(crate) const ROWS: usize = 2;

/// Room for Wᵀ of as many cells of the chunk as are worked on at once.
pub(super) fn w_len(chunk: &Chunk) -> usize {
    let groups = chunk
        .batches
        .iter()
        .flat_map(|batch| chunk.cells[batch.cells.clone()].chunk_by(|a, b| a.pattern == b.pattern));
    groups.map(|cells| cells.len() * P * chunk.patterns[cells[0].pattern as usize].width).max().unwrap_or(0)
}

/// Adds cells with the same pattern, of which `own_block` has been called, to the sums: one product for all of them.
#[inline(always)]
pub(super) fn eliminate<I: Isa>(room: &mut Room<'_>, chunk: &Chunk, cells: &[Cell], at: &mut At) {
    let pattern = &chunk.patterns[cells[0].pattern as usize];
    let locals = &chunk.pattern_locals[pattern.locals.clone()];
    let pairs = &chunk.pair_tiles[pattern.pairs..][..locals.len() * (locals.len() + 1) / 2];
    let width = pattern.width;
    let Room { tiles, vectors, stash, rows, w, .. } = room;
    let w = &mut w[..cells.len() * P * width];
    for (cell, w) in cells.iter().zip(w.chunks_exact_mut(P * width)) {
        let (head, stashed) = stash[cell.stash..][..stash_len(P, pattern.dense)].split_at_mut(stash_head(P));
        let head = Head::<P>::of(head);
        let factors = at.factor..cell.end as usize;
        at.factor = factors.end;
        let these = &chunk.locals[at.local..][..factors.len()];
        at.local += these.len();
        for (&shape, &l) in chunk.shape_of[factors].iter().zip(these) {
            let shape = &chunk.shapes[shape as usize];
            let local = &locals[l as usize];
            // The slack behind the buffer lets loads of whole vectors reach beyond the last row.
            let both = &rows[at.row..][..ROWS * shape.stride + SLACK];
            at.row += ROWS * shape.stride;
            let mut factor = Factor { rows: [&[]; ROWS], jp: [[0.0; P]; ROWS], residual: [0.0; ROWS] };
            for r in 0..ROWS {
                let row = &both[r * shape.stride..];
                factor.rows[r] = &row[shape.segments[0].column..];
                factor.jp[r] =
                    *row[shape.eliminated..].first_chunk().expect("rows hold the eliminated variable");
                factor.residual[r] = row[shape.residual];
            }
            let vectors = &mut vectors[3 * local.at..][..3 * local.padded];
            let w = &mut w[local.column..];
            over_lanes!(local.padded, add_block::<I>(&factor, &head, vectors, local.padded, w, width));
            let at = pairs[l as usize * (l as usize + 3) / 2] as usize;
            let rows_w = [&w[..local.padded], &w[width..][..local.padded], &w[2 * width..][..local.padded]];
            if chunk.elimination == Elimination::Implicit {
                product::<I, ROWS, true>(&factor.rows, &factor.rows, local.dof, local.dof, &mut tiles[at..]);
            } else {
                product_of_two::<I, ROWS, P>(&factor.rows, &rows_w, local.dof, &mut tiles[at..]);
            }
        }
        stash_rows::<P, I>(w, width, locals, stashed);
    }
    if chunk.elimination == Elimination::Implicit {
        return;
    }
    let mut first = 0;
    for (l, b) in locals.iter().enumerate() {
        let of = |local: &Local| Of { column: local.column, dof: local.dof };
        for (a, &at) in locals[..l].iter().zip(&pairs[first..]) {
            subtract_product::<I>(w, width, of(a), of(b), &mut tiles[at as usize..]);
        }
        first += l + 1;
    }
}

/// The numbers of one factor.
struct Factor<'a> {
    /// By its kept block, from the first column on.
    rows: [&'a [f64]; ROWS],
    jp: [[f64; P]; ROWS],
    residual: [f64; ROWS],
}

/// Gradient, correction and diagonal of one block, and Y.
#[inline(always)]
fn add_block<V: Vector>(
    lane: usize,
    factor: &Factor<'_>,
    head: &Head<P>,
    vectors: &mut [f64],
    padded: usize,
    w: &mut [f64],
    width: usize,
) {
    let mut j = [V::splat(0.0); ROWS];
    for r in 0..ROWS {
        j[r] = V::load(&factor.rows[r][lane..]);
    }
    let mut rows = [V::splat(0.0); P];
    let mut c = V::load(&vectors[padded + lane..]);
    for k in 0..P {
        let mut sum = j[0].mul(V::splat(factor.jp[0][k]));
        for r in 1..ROWS {
            sum = j[r].mul_add(V::splat(factor.jp[r][k]), sum);
        }
        for i in 0..k {
            sum = V::splat(head.factor[k][i]).neg_mul_add(rows[i], sum);
        }
        rows[k] = sum.mul(V::splat(head.inverse[k]));
        rows[k].store(&mut w[k * width + lane..]);
        c = V::splat(head.y[k]).mul_add(rows[k], c);
    }
    let (mut g, mut d) = (V::load(&vectors[lane..]), V::load(&vectors[2 * padded + lane..]));
    for r in 0..ROWS {
        g = j[r].mul_add(V::splat(factor.residual[r]), g);
        d = j[r].mul_add(j[r], d);
    }
    g.store(&mut vectors[lane..]);
    c.store(&mut vectors[padded + lane..]);
    d.store(&mut vectors[2 * padded + lane..]);
}
