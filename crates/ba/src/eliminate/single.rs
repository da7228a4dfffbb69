//! The elimination of a point that is seen once by each of some cameras, with nothing that these
//! share: the bulk of most bundle adjustments. Then each factor has two rows, each of its cell's
//! blocks belongs to one factor, and what [`cell`](super::cell) sums up in memory stays in
//! registers.
// One index runs through several arrays, and closures are not compiled for the instruction set.
#![allow(clippy::needless_range_loop)]

use super::cursor::At;
use super::product::{Of, over_lanes, product, sum_product};
use super::simd::{Isa, Task, Vector, WIDE};
use super::stash::{Head, stash_rows};
use super::workspace::{Room, SLACK};
use crate::structure::{
    Cell, Chunk, Elimination, SINGLE_ROWS as ROWS, padded, stash_head, stash_len,
};

/// Degrees of freedom of a point.
const P: usize = 3;

/// Adds cells with the same pattern, of which `own_block` has been called, to the sums: one product
/// for all of them. `D` is the size of all their blocks, known to the compiler, or 0.
///
/// With Z = J_p L⁻ᵀ of one factor, two rows of P numbers, Y = ZᵀJ_c, and its part of C − YᵀY is
/// J_cᵀ (I − ZZᵀ) J_c: two products of rows instead of the five of J_cᵀJ_c and YᵀY.
pub(super) struct Eliminate<'a, 'r, const D: usize> {
    pub(super) room: &'a mut Room<'r>,
    pub(super) chunk: &'a Chunk,
    pub(super) cells: &'a [Cell],
    pub(super) at: &'a mut At,
}

impl<const D: usize> Task for Eliminate<'_, '_, D> {
    #[inline(always)]
    fn run<I: Isa>(self) {
        let Self { room, chunk, cells, at } = self;
        let pattern = chunk.patterns.of(&cells[0]);
        let locals = chunk.patterns.locals_of(&cells[0]);
        let pairs =
            &chunk.patterns.pair_tiles[pattern.pairs..][..locals.len() * (locals.len() + 1) / 2];
        let width = pattern.width;
        let Room { tiles, vectors, stash, rows, w, turned, .. } = room;
        let w = &mut w[..cells.len() * P * width];
        for (cell, w) in cells.iter().zip(w.chunks_exact_mut(P * width)) {
            let (head, stashed) = stash[cell.stash..]
                [..stash_len(P, pattern.dense, chunk.elimination)]
                .split_at_mut(stash_head(P));
            let head = Head::<P>::of(head);
            let factors = at.factor..cell.end as usize;
            at.factor = factors.end;
            let these = &chunk.factors.locals[at.local..][..factors.len()];
            at.local += these.len();
            for (&shape, &l) in chunk.factors.shape_of[factors].iter().zip(these) {
                let shape = &chunk.factors.shapes[shape as usize];
                let local = &locals[l as usize];
                let dof = local.dof_or::<D>();
                let lanes = padded(dof);
                // The slack behind the buffer lets loads of whole vectors reach beyond the last
                // row.
                let both = &rows[at.row..][..ROWS * shape.stride + SLACK];
                at.row += ROWS * shape.stride;
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
                let factor = Factor::new::<I>(rows, z, residual, &head, chunk.elimination);
                let turned = &mut turned[..ROWS * lanes];
                let mut block = Block {
                    lanes,
                    vectors: &mut vectors[3 * local.at..][..3 * lanes],
                    y: &mut w[local.column..][..(P - 1) * width + lanes],
                    width,
                    turned,
                };
                over_lanes!(lanes, add_block::<I>(&factor, &mut block));
                let at = pairs[l as usize * (l as usize + 3) / 2] as usize;
                let turned = [&turned[..lanes], &turned[lanes..]];
                product::<I, ROWS>(&rows, &turned, dof, dof, &mut tiles[at..]);
            }
            stash_rows::<P, I, D>(w, width, locals, stashed, chunk.elimination);
        }
        if chunk.elimination == Elimination::Implicit {
            return;
        }
        let mut first = 0;
        for (l, b) in locals.iter().enumerate() {
            let b = Of { column: b.column, dof: b.dof_or::<D>() };
            for (a, &at) in locals[..l].iter().zip(&pairs[first..]) {
                let a = Of { column: a.column, dof: a.dof_or::<D>() };
                sum_product::<I, false>(w.chunks_exact(width), a, b, &mut tiles[at as usize..]);
            }
            first += l + 1;
        }
    }
}

/// The numbers of one factor.
struct Factor<'a> {
    /// J_c, from its first column on.
    rows: [&'a [f64]; ROWS],
    residual: [f64; ROWS],
    z: [[f64; P]; ROWS],
    /// I − ZZᵀ; I where nothing is to be subtracted.
    rest: [[f64; ROWS]; ROWS],
    /// Zy.
    corrected: [f64; ROWS],
}

impl<'a> Factor<'a> {
    /// From `z` = J_p.
    #[inline(always)]
    fn new<I: Isa>(
        rows: [&'a [f64]; ROWS],
        mut z: [[f64; P]; ROWS],
        residual: [f64; ROWS],
        head: &Head<P>,
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

/// What a factor is added to, of the block that it sees.
struct Block<'a> {
    lanes: usize,
    /// Gradient, correction and diagonal.
    vectors: &'a mut [f64],
    /// Rows that are `width` apart.
    y: &'a mut [f64],
    width: usize,
    /// (I − ZZᵀ) J_c.
    turned: &'a mut [f64],
}

/// Gradient, correction and diagonal of one block, Y, and (I − ZZᵀ) J_c.
#[inline(always)]
fn add_block<V: Vector>(lane: usize, factor: &Factor<'_>, block: &mut Block<'_>) {
    let Block { lanes, width, .. } = *block;
    let Block { vectors, y, turned, .. } = block;
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
        sum.store(&mut turned[s * lanes + lane..]);
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
