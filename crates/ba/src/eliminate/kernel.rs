//! The inner loops of the elimination, compiled once per instruction set and ignorant of factors.
//!
//! Rows are padded to multiples of [`LANES`](super::simd::LANES); what the padding holds is never
//! looked at.

use super::cell;
use super::cursor::At;
use super::normal;
use super::simd::{Isa, Task, dispatch};
use super::single;
use super::workspace::Room;
use crate::damping::marquardt;
use crate::structure::{Batch, Cell, Chunk, row, stash_head};

/// A batch, whose rows are in `room.rows`, on its way into the sums.
pub(super) struct Work<'a, 'r> {
    pub(super) room: &'a mut Room<'r>,
    pub(super) chunk: &'a Chunk,
    pub(super) batch: &'a Batch,
    pub(super) lambda: f64,
    pub(super) at: &'a mut At,
}

impl Work<'_, '_> {
    /// Adds it to the sums.
    pub(super) fn eliminate(self) {
        dispatch(self);
    }
}

impl Task for Work<'_, '_> {
    /// Passes over the cells: the first is short but hangs on square roots and divisions, of which
    /// several then overlap.
    fn run<I: Isa>(self) {
        let Self { room, chunk, batch, lambda, at } = self;
        at.row = 0;
        let mut ahead = *at;
        let all = &chunk.cells[batch.cells.clone()];
        for cells in all.chunk_by(|a, b| a.dof == b.dof) {
            match cells[0].dof {
                0 => own_blocks::<0, I>(room, chunk, cells, lambda, &mut ahead),
                1 => own_blocks::<1, I>(room, chunk, cells, lambda, &mut ahead),
                2 => own_blocks::<2, I>(room, chunk, cells, lambda, &mut ahead),
                3 => own_blocks::<3, I>(room, chunk, cells, lambda, &mut ahead),
                4 => own_blocks::<4, I>(room, chunk, cells, lambda, &mut ahead),
                5 => own_blocks::<5, I>(room, chunk, cells, lambda, &mut ahead),
                _ => own_blocks::<6, I>(room, chunk, cells, lambda, &mut ahead),
            }
        }
        if !batch.bundles.is_empty() {
            I::run(normal::Add {
                room,
                chunk,
                bundles: &chunk.bundles.list[batch.bundles.clone()],
            });
        }
        let alike =
            |a: &Cell, b: &Cell| (a.pattern, a.dof, a.single) == (b.pattern, b.dof, b.single);
        for cells in all.chunk_by(alike) {
            match cells[0].dof {
                0 => at.skip(chunk, cells),
                1 => I::run(cell::Eliminate::<1> { room, chunk, cells, at }),
                2 => I::run(cell::Eliminate::<2> { room, chunk, cells, at }),
                3 if cells[0].single => match chunk.patterns.of(&cells[0]).dof {
                    6 => I::run(single::Eliminate::<6> { room, chunk, cells, at }),
                    9 => I::run(single::Eliminate::<9> { room, chunk, cells, at }),
                    _ => I::run(single::Eliminate::<0> { room, chunk, cells, at }),
                },
                3 => I::run(cell::Eliminate::<3> { room, chunk, cells, at }),
                4 => I::run(cell::Eliminate::<4> { room, chunk, cells, at }),
                5 => I::run(cell::Eliminate::<5> { room, chunk, cells, at }),
                _ => I::run(cell::Eliminate::<6> { room, chunk, cells, at }),
            }
        }
    }
}

/// [`own_block`] of some cells.
fn own_blocks<const P: usize, I: Isa>(
    room: &mut Room<'_>,
    chunk: &Chunk,
    cells: &[Cell],
    lambda: f64,
    at: &mut At,
) {
    struct OwnBlocks<'a, 'r, const P: usize>(
        &'a mut Room<'r>,
        &'a Chunk,
        &'a [Cell],
        f64,
        &'a mut At,
    );
    impl<const P: usize> Task for OwnBlocks<'_, '_, P> {
        #[inline(always)]
        fn run<I: Isa>(self) {
            let Self(room, chunk, cells, lambda, at) = self;
            for cell in cells {
                own_block::<P, I>(room, chunk, cell, lambda, at);
            }
        }
    }
    I::run(OwnBlocks::<P>(room, chunk, cells, lambda, at));
}

/// V = LLᵀ and y of one cell, into its stash; and zeros in the columns that are held.
#[inline(always)]
fn own_block<const P: usize, I: Isa>(
    room: &mut Room<'_>,
    chunk: &Chunk,
    cell: &Cell,
    lambda: f64,
    at: &mut At,
) {
    let Room { stash, rows, gradient_max, .. } = room;
    let (mut v, mut g) = ([[0.0; P]; P], [0.0; P]);
    while at.factor < cell.end as usize {
        let shape = chunk.factors.shape(at.factor);
        at.factor += 1;
        let rows = &mut rows[at.row..][..shape.rows * shape.stride];
        at.row += rows.len();
        for &column in &shape.held {
            for row in rows.chunks_exact_mut(shape.stride) {
                row[column] = 0.0;
            }
        }
        for row in rows.chunks_exact(shape.stride) {
            let jp: &[f64; P] =
                row[shape.eliminated..].first_chunk().expect("rows hold the eliminated variable");
            let residual = row[shape.residual];
            for i in 0..P {
                for j in 0..=i {
                    v[i][j] = I::mul_add_one(jp[i], jp[j], v[i][j]);
                }
                g[i] = I::mul_add_one(jp[i], residual, g[i]);
            }
        }
    }
    if P == 0 {
        return;
    }
    let mut is_seen = [true; P];
    for i in 0..P {
        is_seen[i] = v[i][i] != 0.0;
        *gradient_max = gradient_max.max(g[i].abs());
        v[i][i] += marquardt(v[i][i], lambda);
    }
    let mut inverse = [0.0; P];
    cholesky::<P>(&mut v, &mut inverse);
    let mut y = g;
    for i in 0..P {
        if !is_seen[i] {
            inverse[i] = 0.0;
        }
        for j in 0..i {
            y[i] -= v[i][j] * y[j];
        }
        y[i] *= inverse[i];
    }
    let head = &mut stash[cell.stash..][..stash_head(P)];
    for i in 0..P {
        head[row(i)..][..i].copy_from_slice(&v[i][..i]);
        head[row(i) + i] = inverse[i];
        head[row(P) + i] = y[i];
    }
}

/// The lower Cholesky factor of a damped, hence positive definite, matrix, in place; and the
/// inverses of its diagonal.
#[inline(always)]
fn cholesky<const P: usize>(v: &mut [[f64; P]; P], inverse: &mut [f64; P]) {
    for j in 0..P {
        for k in 0..j {
            v[j][j] -= v[j][k] * v[j][k];
        }
        v[j][j] = v[j][j].sqrt();
        inverse[j] = 1.0 / v[j][j];
        for i in j + 1..P {
            for k in 0..j {
                v[i][j] -= v[i][k] * v[j][k];
            }
            v[i][j] *= inverse[j];
        }
    }
}
