//! The inner loops of the elimination, compiled once per instruction set and ignorant of factors.
//!
//! Rows are padded to multiples of [`LANES`]; what the padding holds is never looked at.

#[cfg(target_arch = "x86_64")]
use super::lanes::{Fused, Fused512};
use super::lanes::{Isa, LANES, Portable, Stored, Task, Vector, WIDE};
use super::product::over_lanes;
use super::{Path, Room, cell, damping, normal, row, single, stash_head};
use crate::structure::{Batch, Cell, Chunk, Elimination, Local, padded};

/// Vector loads of the last row of a batch may reach beyond it by less than this: the widest merged block.
pub(super) const SLACK: usize = 32;

/// Where in a chunk the elimination has got to.
#[derive(Clone, Copy, Default)]
pub(super) struct At {
    pub(super) factor: usize,
    pub(super) local: usize,
    /// In the rows of the batch.
    pub(super) row: usize,
}

impl At {
    /// Past cells of which nothing is subtracted.
    pub(super) fn skip(&mut self, chunk: &Chunk, cells: &[Cell]) {
        for &shape in &chunk.shape_of[self.factor..cells[cells.len() - 1].end as usize] {
            let shape = &chunk.shapes[shape as usize];
            self.local += shape.segments.len();
            self.row += shape.rows * shape.stride;
            self.factor += 1;
        }
    }
}

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
        match super::path() {
            #[cfg(target_arch = "x86_64")]
            Path::Fused512 => self.eliminate_on::<Fused512>(),
            #[cfg(target_arch = "x86_64")]
            Path::Fused => self.eliminate_on::<Fused>(),
            Path::Portable => self.eliminate_on::<Portable>(),
        }
    }

    /// Passes over the cells: the first is short but hangs on square roots and divisions, of which several then overlap.
    fn eliminate_on<I: Isa>(self) {
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
            I::run(normal::Add { room, chunk, bundles: &chunk.bundles[batch.bundles.clone()] });
        }
        let alike = |a: &Cell, b: &Cell| (a.pattern, a.dof, a.single) == (b.pattern, b.dof, b.single);
        for cells in all.chunk_by(alike) {
            match cells[0].dof {
                0 => at.skip(chunk, cells),
                1 => I::run(cell::Eliminate::<1> { room, chunk, cells, at }),
                2 => I::run(cell::Eliminate::<2> { room, chunk, cells, at }),
                3 if cells[0].single => match chunk.patterns[cells[0].pattern as usize].dof {
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
    struct OwnBlocks<'a, 'r, const P: usize>(&'a mut Room<'r>, &'a Chunk, &'a [Cell], f64, &'a mut At);
    impl<const P: usize, I: Isa> Task<I> for OwnBlocks<'_, '_, P> {
        #[inline(always)]
        fn run(self) {
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
        let shape = &chunk.shapes[chunk.shape_of[at.factor] as usize];
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
        v[i][i] += damping(v[i][i], lambda);
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

/// The lower Cholesky factor of a damped, hence positive definite, matrix, in place; and the inverses of its diagonal.
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

/// What back-substitution adds up for one cell: step += Y δ_c.
#[inline(always)]
fn multiply_on<I: Isa, T: Stored>(y: &[T], locals: &[Local], kept: &[f64], step: &mut [f64]) {
    match step.len() {
        1 => multiply_rows::<1, I, T>(y, locals, kept, step),
        2 => multiply_rows::<2, I, T>(y, locals, kept, step),
        3 => multiply_rows::<3, I, T>(y, locals, kept, step),
        4 => multiply_rows::<4, I, T>(y, locals, kept, step),
        5 => multiply_rows::<5, I, T>(y, locals, kept, step),
        _ => multiply_rows::<6, I, T>(y, locals, kept, step),
    }
}

#[inline(always)]
fn multiply_rows<const P: usize, I: Isa, T: Stored>(
    y: &[T],
    locals: &[Local],
    kept: &[f64],
    step: &mut [f64],
) {
    let mut sums = [I::Narrow::splat(0.0); P];
    for local in locals {
        // Beyond the end of a row, Y holds what belongs to the next one, and δ_c holds zeros.
        let y = &y[P * local.dense..][..(P - 1) * local.dof + local.padded];
        let kept = &kept[local.at..][..local.padded];
        for lane in (0..local.padded).step_by(LANES) {
            let kept = I::Narrow::load(&kept[lane..]);
            for k in 0..P {
                sums[k] = T::load::<I::Narrow>(&y[k * local.dof + lane..]).mul_add(kept, sums[k]);
            }
        }
    }
    for k in 0..P {
        let mut parts = [0.0; LANES];
        sums[k].store(&mut parts);
        step[k] += (parts[0] + parts[1]) + (parts[2] + parts[3]);
    }
}

/// See [`Y`](super::Y).
pub(super) fn multiply<T: Stored>(y: &[T], locals: &[Local], kept: &[f64], step: &mut [f64]) {
    struct Multiply<'a, T>(&'a [T], &'a [Local], &'a [f64], &'a mut [f64]);
    impl<I: Isa, T: Stored> Task<I> for Multiply<'_, T> {
        #[inline(always)]
        fn run(self) {
            multiply_on::<I, T>(self.0, self.1, self.2, self.3);
        }
    }
    let task = Multiply(y, locals, kept, step);
    match super::path() {
        Path::Portable => Portable::run(task),
        #[cfg(target_arch = "x86_64")]
        _ => Fused::run(task),
    }
}

/// See [`Y`](super::Y).
pub(super) fn multiply_transposed<T: Stored>(y: &[T], locals: &[Local], u: &[f64], kept: &mut [f64]) {
    for local in locals {
        let kept = &mut kept[local.at..][..local.dof];
        for (row, u) in y[u.len() * local.dense..].chunks_exact(local.dof).zip(u) {
            kept.iter_mut().zip(row).for_each(|(kept, y)| *kept += y.number() * u);
        }
    }
}

/// Copies Yᵀ of a cell's blocks, whose rows are `width` apart, to its stash. Vectors overlap what comes next, which is therefore
/// written later.
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
