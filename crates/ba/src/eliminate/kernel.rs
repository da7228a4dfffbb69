//! The inner loops of the elimination, compiled once per instruction set and ignorant of factors.
//!
//! Rows are padded to multiples of [`LANES`]; what the padding holds is never looked at.

#[cfg(target_arch = "x86_64")]
use super::lanes::Fused;
use super::lanes::{Isa, LANES, Portable, lanes, lanes_mut};
use super::{Sums, damping, stash_head, stash_len};
use crate::structure::{Cell, Chunk, Local, Shape};

/// Vector loads of the last row of a batch may reach beyond it by less than this: the widest merged block.
pub(super) const SLACK: usize = 32;

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
        let width = pattern.width;
        let Sums { tiles, vectors, stash, rows, w, gradient_max, .. } = &mut *self.sums;
        let w = &mut w[..P * width];
        w.fill(0.0);
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
            let rows = &rows[*self.row_at..][..len + SLACK];
            *self.row_at += len;
            for row in rows[..len].chunks_exact(shape.stride) {
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

        let mut diagonal = [0.0; P];
        for i in 0..P {
            diagonal[i] = v[i][i];
            *gradient_max = gradient_max.max(g[i].abs());
            v[i][i] += damping(v[i][i], self.lambda);
        }
        cholesky::<P>(&mut v);
        let mut inverse = [0.0; P];
        for i in 0..P {
            inverse[i] = 1.0 / v[i][i];
        }
        let mut y = g;
        for i in 0..P {
            for j in 0..i {
                y[i] -= v[i][j] * y[j];
            }
            y[i] *= inverse[i];
        }
        let (head, stashed) = stash[self.cell.stash..][..stash_len(P, width)].split_at_mut(stash_head(P));
        for i in 0..P {
            head[i * P..][..P].copy_from_slice(&v[i]);
            head[P * P + i] = y[i];
            head[P * P + P + i] = g[i];
            head[P * P + 2 * P + i] = diagonal[i];
        }
        whiten::<P, I>(w, stashed, width, &v, &inverse);
        let w = &*w;
        let mut pair = pairs.iter();
        for b in locals {
            let mut rows_b = [&[][..]; P];
            for k in 0..P {
                rows_b[k] = &w[k * width + b.column..][..b.padded];
            }
            let correction = &mut vectors[3 * b.at + b.padded..][..b.padded];
            for lane in (0..b.padded).step_by(LANES) {
                let correction = lanes_mut(&mut correction[lane..]);
                let mut sum = I::load(correction);
                for k in 0..P {
                    sum = I::mul_add(I::splat(y[k]), I::load(lanes(&rows_b[k][lane..])), sum);
                }
                I::store(sum, correction);
            }
            for (a, &at) in locals.iter().zip(pair.by_ref()) {
                let mut rows_a = [&[][..]; P];
                for k in 0..P {
                    rows_a[k] = &w[k * width + a.column..][..a.dof];
                }
                {
                    let tile = &mut tiles[at as usize..][..a.dof * b.padded];
                    product::<P, false, I>(&rows_a, &rows_b, b.padded, tile);
                }
                if a.at == b.at {
                    break;
                }
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
            let (mut jp_lanes, mut residual_lanes) = ([[I::splat(0.0); P]; R], [I::splat(0.0); R]);
            for r in 0..R {
                residual_lanes[r] = I::splat(residual[r]);
                for k in 0..P {
                    jp_lanes[r][k] = I::splat(jp[r][k]);
                }
            }
            for lane in (0..padded).step_by(LANES) {
                let mut j = [I::splat(0.0); R];
                for r in 0..R {
                    j[r] = I::load(lanes(&rows[r][segment.column + lane..]));
                }
                let (gradient, diagonal) =
                    (lanes_mut(&mut gradient[lane..]), lanes_mut(&mut diagonal[lane..]));
                let (mut g, mut d) = (I::load(gradient), I::load(diagonal));
                for r in 0..R {
                    g = I::mul_add(j[r], residual_lanes[r], g);
                    d = I::mul_add(j[r], j[r], d);
                }
                I::store(g, gradient);
                I::store(d, diagonal);
                for k in 0..P {
                    let w = lanes_mut(&mut w[k * width + local.column + lane..]);
                    let mut sum = I::load(w);
                    for r in 0..R {
                        sum = I::mul_add(jp_lanes[r][k], j[r], sum);
                    }
                    I::store(sum, w);
                }
            }
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
            let padded = locals[hi as usize].padded;
            let tile = &mut tiles[at + a.offset * padded..][..a.dof * padded];
            let (mut rows_a, mut rows_b) = ([&[][..]; R], [&[][..]; R]);
            for r in 0..R {
                rows_a[r] = &rows[r][a.column..][..a.dof];
                rows_b[r] = &rows[r][b.column..];
            }
            if b.whole {
                product::<R, true, I>(&rows_a, &rows_b, padded, tile);
            } else {
                for (column, tile) in tile.chunks_exact_mut(padded).enumerate() {
                    for r in 0..R {
                        for (t, i) in tile[b.offset..][..b.dof].iter_mut().zip(&rows[r][b.column..]) {
                            *t = I::mul_add_one(rows_a[r][column], *i, *t);
                        }
                    }
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

/// Y = L⁻¹W: `w` holds Wᵀ row by row, and Y is written both there and to `y`.
#[inline(always)]
fn whiten<const P: usize, I: Isa>(
    w: &mut [f64],
    y: &mut [f64],
    width: usize,
    l: &[[f64; P]; P],
    inverse: &[f64; P],
) {
    for lane in (0..width).step_by(LANES) {
        let mut rows = [I::splat(0.0); P];
        for k in 0..P {
            let at = k * width + lane;
            let row = lanes_mut(&mut w[at..]);
            let mut sum = I::load(row);
            for i in 0..k {
                sum = I::neg_mul_add(I::splat(l[k][i]), rows[i], sum);
            }
            rows[k] = I::mul(sum, I::splat(inverse[k]));
            I::store(rows[k], row);
            I::store(rows[k], lanes_mut(&mut y[at..]));
        }
    }
}

/// tile ± aᵀb with `N` rows each, a tile being `dof(a)` columns of `padded` numbers.
#[inline(always)]
fn product<const N: usize, const PLUS: bool, I: Isa>(
    a: &[&[f64]; N],
    b: &[&[f64]; N],
    padded: usize,
    tile: &mut [f64],
) {
    match padded / LANES {
        1 => product_of::<N, 1, PLUS, I>(a, b, padded, 0, tile),
        2 => product_of::<N, 2, PLUS, I>(a, b, padded, 0, tile),
        3 => product_of::<N, 3, PLUS, I>(a, b, padded, 0, tile),
        _ => {
            for lane in (0..padded).step_by(LANES) {
                product_of::<N, 1, PLUS, I>(a, b, padded, lane, tile);
            }
        }
    }
}

/// The same for `L` vectors of each column, from number `first` on: those of b stay in registers.
#[inline(always)]
fn product_of<const N: usize, const L: usize, const PLUS: bool, I: Isa>(
    a: &[&[f64]; N],
    b: &[&[f64]; N],
    padded: usize,
    first: usize,
    tile: &mut [f64],
) {
    // Loops and not `from_fn`, here and above: closures are not compiled for the instruction set.
    let mut rows = [[I::splat(0.0); L]; N];
    for k in 0..N {
        for l in 0..L {
            rows[k][l] = I::load(lanes(&b[k][first + l * LANES..]));
        }
    }
    let b = rows;
    let columns = tile.len() / padded;
    let mut a = *a;
    for row in &mut a {
        *row = &row[..columns];
    }
    for (j, column) in tile.chunks_exact_mut(padded).enumerate() {
        let column = &mut column[first..][..L * LANES];
        let mut a_j = [I::splat(0.0); N];
        for k in 0..N {
            a_j[k] = I::splat(a[k][j]);
        }
        for l in 0..L {
            let to = lanes_mut(&mut column[l * LANES..]);
            let mut sum = I::load(to);
            for k in 0..N {
                sum = if PLUS {
                    I::mul_add(a_j[k], b[k][l], sum)
                } else {
                    I::neg_mul_add(a_j[k], b[k][l], sum)
                };
            }
            I::store(sum, to);
        }
    }
}

/// What back-substitution adds up for one cell: step += Y δ_c.
#[inline(always)]
fn multiply_on<I: Isa>(y: &[f64], width: usize, locals: &[Local], kept: &[f64], step: &mut [f64]) {
    for (step, row) in step.iter_mut().zip(y.chunks_exact(width.max(1))) {
        let mut sum = I::splat(0.0);
        for local in locals {
            let (row, kept) = (&row[local.column..][..local.padded], &kept[local.at..][..local.padded]);
            for lane in (0..local.padded).step_by(LANES) {
                sum = I::mul_add(I::load(lanes(&row[lane..])), I::load(lanes(&kept[lane..])), sum);
            }
        }
        let mut sums = [0.0; LANES];
        I::store(sum, &mut sums);
        *step += (sums[0] + sums[1]) + (sums[2] + sums[3]);
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn multiply_avx2(y: &[f64], width: usize, locals: &[Local], kept: &[f64], step: &mut [f64]) {
    multiply_on::<Fused>(y, width, locals, kept, step);
}

/// step += Y δ_c, where `kept` holds δ_c over the chunk's blocks, zero in the padding.
pub(super) fn multiply(y: &[f64], width: usize, locals: &[Local], kept: &[f64], step: &mut [f64]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: the features that the function is compiled for have just been found.
        unsafe { multiply_avx2(y, width, locals, kept, step) };
        return;
    }
    multiply_on::<Portable>(y, width, locals, kept, step);
}
