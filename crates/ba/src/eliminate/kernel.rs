//! The inner loops of the elimination, compiled once per instruction set and ignorant of factors.
//!
//! Rows are padded to multiples of [`LANES`]; what the padding holds is never looked at. Products `a·b + c` are fused where
//! the machine can, so that results differ in the last bits between instruction sets, and not otherwise.

use super::{Sums, damping_of, stash_head, stash_len};
use crate::structure::{Cell, Chunk, Local, Segment, Shape};

/// Numbers handled at once.
const LANES: usize = 4;

/// How to multiply and add.
trait Isa {
    fn mul_add(a: f64, b: f64, c: f64) -> f64;
}

struct Portable;
impl Isa for Portable {
    #[inline(always)]
    fn mul_add(a: f64, b: f64, c: f64) -> f64 {
        a * b + c
    }
}

/// Fused: one rounding.
#[cfg(target_arch = "x86_64")]
struct Fused;
#[cfg(target_arch = "x86_64")]
impl Isa for Fused {
    #[inline(always)]
    fn mul_add(a: f64, b: f64, c: f64) -> f64 {
        a.mul_add(b, c)
    }
}

/// Adds the cells of a batch, whose rows are in `sums.rows`, to the sums. `factor` and `local` count through the chunk.
pub(super) fn eliminate(
    sums: &mut Sums,
    shapes: &[Shape],
    chunk: &Chunk,
    cells: std::ops::Range<usize>,
    lambda: f64,
    factor: &mut usize,
    local: &mut usize,
) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: the features that the function is compiled for have just been found.
        unsafe { eliminate_avx2(sums, shapes, chunk, cells, lambda, factor, local) };
        return;
    }
    eliminate_on::<Portable>(sums, shapes, chunk, cells, lambda, factor, local);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn eliminate_avx2(
    sums: &mut Sums,
    shapes: &[Shape],
    chunk: &Chunk,
    cells: std::ops::Range<usize>,
    lambda: f64,
    factor: &mut usize,
    local: &mut usize,
) {
    eliminate_on::<Fused>(sums, shapes, chunk, cells, lambda, factor, local);
}

#[inline(always)]
fn eliminate_on<I: Isa>(
    sums: &mut Sums,
    shapes: &[Shape],
    chunk: &Chunk,
    cells: std::ops::Range<usize>,
    lambda: f64,
    factor: &mut usize,
    local: &mut usize,
) {
    let mut row_at = 0;
    for cell in &chunk.cells[cells] {
        let mut work = Work { sums, shapes, chunk, cell, lambda, factor, local, row_at: &mut row_at };
        match cell.dof {
            0 => work.cell::<0, I>(),
            1 => work.cell::<1, I>(),
            2 => work.cell::<2, I>(),
            3 => work.cell::<3, I>(),
            4 => work.cell::<4, I>(),
            5 => work.cell::<5, I>(),
            _ => work.cell::<6, I>(),
        }
    }
}

struct Work<'a> {
    sums: &'a mut Sums,
    shapes: &'a [Shape],
    chunk: &'a Chunk,
    cell: &'a Cell,
    lambda: f64,
    factor: &'a mut usize,
    local: &'a mut usize,
    row_at: &'a mut usize,
}

impl Work<'_> {
    #[inline(always)]
    fn cell<const P: usize, I: Isa>(&mut self) {
        let chunk = self.chunk;
        let pattern = &chunk.patterns[self.cell.pattern as usize];
        let locals = &chunk.pattern_locals[pattern.locals.clone()];
        let pairs = &chunk.pair_tiles[pattern.pairs..][..locals.len() * (locals.len() + 1) / 2];
        let Sums { tiles, gradient, correction, diagonal, stash, rows, gradient_max, .. } = &mut *self.sums;
        let stash =
            if P == 0 { &mut [][..] } else { &mut stash[self.cell.stash..][..stash_len(P, pattern.width)] };
        let (head, w) = stash.split_at_mut(if P == 0 { 0 } else { stash_head(P) });
        let mut v = [[0.0; P]; P];
        let mut g = [0.0; P];

        while *self.factor < self.cell.end as usize {
            let shape = &self.shapes[chunk.shapes[*self.factor] as usize];
            *self.factor += 1;
            let these = &chunk.locals[*self.local..][..shape.segments.len()];
            *self.local += these.len();
            let len = shape.rows * shape.stride;
            for &column in &shape.held {
                for row in rows[*self.row_at..][..len].chunks_exact_mut(shape.stride) {
                    row[column] = 0.0;
                }
            }
            // The slack behind the buffer lets loads of whole vectors reach beyond the last row.
            let rows = &rows[*self.row_at..][..len + 2 * LANES];
            *self.row_at += len;
            for row in rows[..len].chunks_exact(shape.stride) {
                let jp: &[f64] = &row[shape.eliminated..][..P];
                for i in 0..P {
                    for j in 0..=i {
                        v[i][j] = I::mul_add(jp[i], jp[j], v[i][j]);
                    }
                    g[i] = I::mul_add(jp[i], row[shape.residual], g[i]);
                }
            }
            for (s, (segment, &l)) in shape.segments.iter().zip(these).enumerate() {
                let local = &locals[l as usize];
                add_to_vectors::<I>(rows, shape, segment, local, gradient, diagonal);
                add_to_w::<P, I>(rows, shape, segment, local, pattern.width, w);
                for (other, &m) in shape.segments[..=s].iter().zip(these) {
                    let (lo, hi) = if m <= l { (m, l) } else { (l, m) };
                    let (a, b) = if (m, other.offset) <= (l, segment.offset) {
                        (other, segment)
                    } else {
                        (segment, other)
                    };
                    let at = pairs[hi as usize * (hi as usize + 1) / 2 + lo as usize] as usize;
                    let local = &locals[hi as usize];
                    let tile = &mut tiles[at..][..locals[lo as usize].dof * local.padded];
                    add_product::<I>(rows, shape, a, b, local.padded, tile);
                }
            }
        }
        if P == 0 {
            return;
        }

        let mut damping = [0.0; P];
        for i in 0..P {
            damping[i] = damping_of(v[i][i]);
            *gradient_max = gradient_max.max(g[i].abs());
            v[i][i] += self.lambda * damping[i];
        }
        let (y, inverse) = {
            cholesky::<P>(&mut v);
            let inverse: [f64; P] = std::array::from_fn(|i| 1.0 / v[i][i]);
            let mut y = g;
            for i in 0..P {
                for j in 0..i {
                    y[i] -= v[i][j] * y[j];
                }
                y[i] *= inverse[i];
            }
            (y, inverse)
        };
        for i in 0..P {
            head[i * P..][..P].copy_from_slice(&v[i]);
            head[P * P + i] = y[i];
            head[P * P + P + i] = g[i];
            head[P * P + 2 * P + i] = damping[i];
        }
        whiten::<P, I>(w, pattern.width, &v, &inverse);
        let mut pair = pairs.iter();
        for b in locals {
            let rows_b: [&[f64]; P] = std::array::from_fn(|k| &w[k * pattern.width + b.column..][..b.padded]);
            for k in 0..P {
                axpy::<I>(y[k], rows_b[k], &mut correction[b.at..][..b.padded]);
            }
            for (a, &at) in locals.iter().zip(pair.by_ref()) {
                let rows_a: [&[f64]; P] =
                    std::array::from_fn(|k| &w[k * pattern.width + a.column..][..a.dof]);
                subtract_product::<P, I>(&rows_a, &rows_b, &mut tiles[at as usize..][..a.dof * b.padded]);
                if a.at == b.at {
                    break;
                }
            }
        }
    }
}

#[inline(always)]
fn lanes(slice: &[f64]) -> &[f64; LANES] {
    slice.first_chunk().expect("at least one vector")
}

/// y += a x, for lengths that are multiples of `LANES`.
#[inline(always)]
fn axpy<I: Isa>(a: f64, x: &[f64], y: &mut [f64]) {
    let (x, y) = (x.as_chunks::<LANES>().0, y.as_chunks_mut::<LANES>().0);
    for (x, y) in x.iter().zip(y) {
        for i in 0..LANES {
            y[i] = I::mul_add(a, x[i], y[i]);
        }
    }
}

/// g += Jᵀr and D += diag JᵀJ, for one segment.
#[inline(always)]
fn add_to_vectors<I: Isa>(
    rows: &[f64],
    shape: &Shape,
    segment: &Segment,
    local: &Local,
    gradient: &mut [f64],
    diagonal: &mut [f64],
) {
    let at = local.at + segment.offset;
    let (gradient, diagonal) = (&mut gradient[at..][..segment.dof], &mut diagonal[at..][..segment.dof]);
    for r in 0..shape.rows {
        let row = &rows[r * shape.stride..][..shape.stride];
        let residual = row[shape.residual];
        let row = &row[segment.column..][..segment.dof];
        for ((g, d), j) in gradient.iter_mut().zip(diagonal.iter_mut()).zip(row) {
            *g = I::mul_add(*j, residual, *g);
            *d = I::mul_add(*j, *j, *d);
        }
    }
}

/// W += JᵀJ_p, for one segment.
#[inline(always)]
fn add_to_w<const P: usize, I: Isa>(
    rows: &[f64],
    shape: &Shape,
    segment: &Segment,
    local: &Local,
    width: usize,
    w: &mut [f64],
) {
    for k in 0..P {
        let w = &mut w[k * width + local.column + segment.offset..];
        for r in 0..shape.rows {
            let row = &rows[r * shape.stride..];
            let jp = row[shape.eliminated + k];
            if segment.whole {
                axpy::<I>(jp, &row[segment.column..][..local.padded], &mut w[..local.padded]);
            } else {
                for (w, j) in w[..segment.dof].iter_mut().zip(&row[segment.column..]) {
                    *w = I::mul_add(jp, *j, *w);
                }
            }
        }
    }
}

/// tile += J_aᵀJ_b, for two segments of the same rows.
#[inline(always)]
fn add_product<I: Isa>(
    rows: &[f64],
    shape: &Shape,
    a: &Segment,
    b: &Segment,
    padded: usize,
    tile: &mut [f64],
) {
    if b.whole {
        for r in 0..shape.rows {
            let row = &rows[r * shape.stride..];
            let (row_a, row_b) = (&row[a.column..][..a.dof], &row[b.column..][..padded]);
            for (j, column) in row_a.iter().zip(tile[a.offset * padded..].chunks_exact_mut(padded)) {
                axpy::<I>(*j, row_b, column);
            }
        }
    } else {
        for r in 0..shape.rows {
            let row = &rows[r * shape.stride..];
            let (row_a, row_b) = (&row[a.column..][..a.dof], &row[b.column..][..b.dof]);
            for (j, column) in row_a.iter().zip(tile[a.offset * padded..].chunks_exact_mut(padded)) {
                for (t, i) in column[b.offset..].iter_mut().zip(row_b) {
                    *t = I::mul_add(*j, *i, *t);
                }
            }
        }
    }
}

/// The lower Cholesky factor of a damped, hence positive definite, matrix, in place.
#[inline(always)]
fn cholesky<const P: usize>(v: &mut [[f64; P]; P]) {
    for j in 0..P {
        for k in 0..j {
            v[j][j] -= v[j][k] * v[j][k];
        }
        v[j][j] = v[j][j].sqrt();
        for i in j + 1..P {
            for k in 0..j {
                v[i][j] -= v[i][k] * v[j][k];
            }
            v[i][j] /= v[j][j];
        }
    }
}

/// W ← L⁻¹W, where `w` holds Wᵀ row by row.
#[inline(always)]
fn whiten<const P: usize, I: Isa>(w: &mut [f64], width: usize, l: &[[f64; P]; P], inverse: &[f64; P]) {
    let mut column = 0;
    while column < width {
        let mut y = [[0.0; LANES]; P];
        for k in 0..P {
            let mut sum = *lanes(&w[k * width + column..]);
            for i in 0..k {
                for lane in 0..LANES {
                    sum[lane] = I::mul_add(-l[k][i], y[i][lane], sum[lane]);
                }
            }
            y[k] = sum.map(|sum| sum * inverse[k]);
            w[k * width + column..][..LANES].copy_from_slice(&y[k]);
        }
        column += LANES;
    }
}

/// tile −= aᵀb with `P` rows each.
#[inline(always)]
fn subtract_product<const P: usize, I: Isa>(a: &[&[f64]; P], b: &[&[f64]; P], tile: &mut [f64]) {
    let padded = b[0].len();
    let mut lane = 0;
    while lane < padded {
        let minus_b: [[f64; LANES]; P] = std::array::from_fn(|k| lanes(&b[k][lane..]).map(|b| -b));
        for (j, column) in tile.chunks_exact_mut(padded).enumerate() {
            let Some(t) = column[lane..].first_chunk_mut::<LANES>() else { break };
            for k in 0..P {
                let a = a[k][j];
                for i in 0..LANES {
                    t[i] = I::mul_add(a, minus_b[k][i], t[i]);
                }
            }
        }
        lane += LANES;
    }
}
