//! Products of rows, the innermost loops: `tile ± aᵀb`.

use super::lanes::{Isa, LANES, Vector, WIDE};

/// Calls `f::<V, ..>(i, ..)` for the numbers from 0 to a multiple of [`LANES`], as many at once as will do: from number i on, with
/// vectors of type V.
macro_rules! over_lanes {
    ($len:expr, $f:ident::<$I:ident $(, $n:ident)*>($($argument:expr),*)) => {{
        let len: usize = $len;
        let mut at = 0;
        while at + WIDE <= len {
            $f::<<$I as Isa>::Wide $(, $n)*>(at, $($argument),*);
            at += WIDE;
        }
        if at < len {
            $f::<<$I as Isa>::Narrow $(, $n)*>(at, $($argument),*);
        }
    }};
}

pub(super) use over_lanes;

/// tile ± aᵀb with `N` rows each, a tile being `dof(a)` columns of `padded` numbers.
#[inline(always)]
pub(super) fn product<const N: usize, const PLUS: bool, I: Isa>(
    a: &[&[f64]; N],
    b: &[&[f64]; N],
    padded: usize,
    tile: &mut [f64],
) {
    match padded / LANES {
        1 => product_of::<N, 0, 1, PLUS, I>(a, b, padded, 0, tile),
        2 => product_of::<N, 1, 0, PLUS, I>(a, b, padded, 0, tile),
        3 => product_of::<N, 1, 1, PLUS, I>(a, b, padded, 0, tile),
        4 => product_of::<N, 2, 0, PLUS, I>(a, b, padded, 0, tile),
        _ => {
            for lane in (0..padded).step_by(LANES) {
                product_of::<N, 0, 1, PLUS, I>(a, b, padded, lane, tile);
            }
        }
    }
}

/// The same for `L` wide and `S` narrow vectors of each column, from number `first` on: those of b stay in registers.
#[inline(always)]
fn product_of<const N: usize, const L: usize, const S: usize, const PLUS: bool, I: Isa>(
    a: &[&[f64]; N],
    b: &[&[f64]; N],
    padded: usize,
    first: usize,
    tile: &mut [f64],
) {
    // Loops and not `from_fn`, here and above: closures are not compiled for the instruction set.
    let (mut wide, mut narrow) = ([[I::Wide::splat(0.0); L]; N], [[I::Narrow::splat(0.0); S]; N]);
    load_rows::<N, L, S, I>(b, first, &mut wide, &mut narrow);
    let a = *a;
    for (j, column) in tile.chunks_exact_mut(padded).enumerate() {
        let column = &mut column[first..][..L * WIDE + S * LANES];
        let (column, rest) = column.split_at_mut(L * WIDE);
        for l in 0..L {
            add_column::<N, PLUS, I::Wide, L>(&a, j, &wide, l, &mut column[l * WIDE..]);
        }
        for s in 0..S {
            add_column::<N, PLUS, I::Narrow, S>(&a, j, &narrow, s, &mut rest[s * LANES..]);
        }
    }
}

/// One vector of one column.
#[inline(always)]
fn add_column<const N: usize, const PLUS: bool, V: Vector, const L: usize>(
    a: &[&[f64]; N],
    j: usize,
    b: &[[V; L]; N],
    l: usize,
    to: &mut [f64],
) {
    let mut sum = V::load(to);
    for k in 0..N {
        let a = V::splat(a[k][j]);
        sum = if PLUS { a.mul_add(b[k][l], sum) } else { a.neg_mul_add(b[k][l], sum) };
    }
    sum.store(to);
}

/// tile + aᵀa − bᵀb, of which the lower triangle is meant.
#[inline(always)]
pub(super) fn product_of_two<const N: usize, const M: usize, I: Isa>(
    a: &[&[f64]; N],
    b: &[&[f64]; M],
    padded: usize,
    tile: &mut [f64],
) {
    match padded / LANES {
        1 => product_of_two_from::<N, M, 0, 1, I>(a, b, padded, 0, tile),
        2 => product_of_two_from::<N, M, 1, 0, I>(a, b, padded, 0, tile),
        3 => product_of_two_from::<N, M, 1, 1, I>(a, b, padded, 0, tile),
        _ => {
            for lane in (0..padded).step_by(LANES) {
                product_of_two_from::<N, M, 0, 1, I>(a, b, padded, lane, tile);
            }
        }
    }
}

#[inline(always)]
fn product_of_two_from<const N: usize, const M: usize, const L: usize, const S: usize, I: Isa>(
    a: &[&[f64]; N],
    b: &[&[f64]; M],
    padded: usize,
    first: usize,
    tile: &mut [f64],
) {
    let (mut wide_a, mut narrow_a) = ([[I::Wide::splat(0.0); L]; N], [[I::Narrow::splat(0.0); S]; N]);
    let (mut wide_b, mut narrow_b) = ([[I::Wide::splat(0.0); L]; M], [[I::Narrow::splat(0.0); S]; M]);
    load_rows::<N, L, S, I>(a, first, &mut wide_a, &mut narrow_a);
    load_rows::<M, L, S, I>(b, first, &mut wide_b, &mut narrow_b);
    let (a, b) = (*a, *b);
    for (j, column) in tile.chunks_exact_mut(padded).enumerate() {
        let column = &mut column[first..][..L * WIDE + S * LANES];
        let (column, rest) = column.split_at_mut(L * WIDE);
        for l in 0..L {
            add_column::<N, true, I::Wide, L>(&a, j, &wide_a, l, &mut column[l * WIDE..]);
            add_column::<M, false, I::Wide, L>(&b, j, &wide_b, l, &mut column[l * WIDE..]);
        }
        for s in 0..S {
            add_column::<N, true, I::Narrow, S>(&a, j, &narrow_a, s, &mut rest[s * LANES..]);
            add_column::<M, false, I::Narrow, S>(&b, j, &narrow_b, s, &mut rest[s * LANES..]);
        }
    }
}

/// Whole vectors of each row, from number `first` on.
#[inline(always)]
fn load_rows<const N: usize, const L: usize, const S: usize, I: Isa>(
    rows: &[&[f64]; N],
    first: usize,
    wide: &mut [[I::Wide; L]; N],
    narrow: &mut [[I::Narrow; S]; N],
) {
    for k in 0..N {
        for l in 0..L {
            wide[k][l] = I::Wide::load(&rows[k][first + l * WIDE..]);
        }
        for s in 0..S {
            narrow[k][s] = I::Narrow::load(&rows[k][first + L * WIDE + s * LANES..]);
        }
    }
}

/// tile − aᵀb over all rows of `w`, of which a and b are columns: the sums stay in registers meanwhile.
#[inline(always)]
pub(super) fn subtract_product<I: Isa>(
    w: &[f64],
    width: usize,
    a: usize,
    b: usize,
    padded: usize,
    tile: &mut [f64],
) {
    match padded / LANES {
        1 => subtract_columns::<0, 1, I>(w, width, a, b, padded, tile),
        2 => subtract_columns::<1, 0, I>(w, width, a, b, padded, tile),
        3 => subtract_columns::<1, 1, I>(w, width, a, b, padded, tile),
        4 => subtract_columns::<2, 0, I>(w, width, a, b, padded, tile),
        _ => {
            for first in (0..padded).step_by(LANES) {
                let tile = &mut tile[first..];
                subtract_columns::<0, 1, I>(w, width, a, b + first, padded, tile);
            }
        }
    }
}

/// Columns that are summed up at once: their sums, `L` + `S` vectors each, should fit the registers.
#[inline(always)]
fn subtract_columns<const L: usize, const S: usize, I: Isa>(
    w: &[f64],
    width: usize,
    a: usize,
    b: usize,
    padded: usize,
    tile: &mut [f64],
) {
    let (mut tile, mut a) = (tile, a);
    if I::MANY_REGISTERS {
        while tile.len() > 8 * padded {
            let (these, rest) = tile.split_at_mut((9 * padded).min(tile.len()));
            subtract_some::<9, L, S, I>(w, width, a, b, padded, these);
            (tile, a) = (rest, a + 9);
        }
        while tile.len() > 5 * padded {
            let (these, rest) = tile.split_at_mut((6 * padded).min(tile.len()));
            subtract_some::<6, L, S, I>(w, width, a, b, padded, these);
            (tile, a) = (rest, a + 6);
        }
    }
    while tile.len() > 2 * padded {
        let (these, rest) = tile.split_at_mut((3 * padded).min(tile.len()));
        subtract_some::<3, L, S, I>(w, width, a, b, padded, these);
        (tile, a) = (rest, a + 3);
    }
    while !tile.is_empty() {
        let (these, rest) = tile.split_at_mut(padded.min(tile.len()));
        subtract_some::<1, L, S, I>(w, width, a, b, padded, these);
        (tile, a) = (rest, a + 1);
    }
}

#[inline(always)]
fn subtract_some<const C: usize, const L: usize, const S: usize, I: Isa>(
    w: &[f64],
    width: usize,
    a: usize,
    b: usize,
    padded: usize,
    tile: &mut [f64],
) {
    let (mut wide, mut narrow) = ([[I::Wide::splat(0.0); L]; C], [[I::Narrow::splat(0.0); S]; C]);
    for c in 0..C {
        for l in 0..L {
            wide[c][l] = I::Wide::load(&tile[c * padded + l * WIDE..]);
        }
        for s in 0..S {
            narrow[c][s] = I::Narrow::load(&tile[c * padded + L * WIDE + s * LANES..]);
        }
    }
    for row in w.chunks_exact(width) {
        let a: &[f64; C] = row[a..].first_chunk().expect("rows hold all columns of a");
        let (mut b_wide, mut b_narrow) = ([I::Wide::splat(0.0); L], [I::Narrow::splat(0.0); S]);
        for l in 0..L {
            b_wide[l] = I::Wide::load(&row[b + l * WIDE..]);
        }
        for s in 0..S {
            b_narrow[s] = I::Narrow::load(&row[b + L * WIDE + s * LANES..]);
        }
        for c in 0..C {
            for l in 0..L {
                wide[c][l] = I::Wide::splat(a[c]).neg_mul_add(b_wide[l], wide[c][l]);
            }
            for s in 0..S {
                narrow[c][s] = I::Narrow::splat(a[c]).neg_mul_add(b_narrow[s], narrow[c][s]);
            }
        }
    }
    for c in 0..C {
        for l in 0..L {
            wide[c][l].store(&mut tile[c * padded + l * WIDE..]);
        }
        for s in 0..S {
            narrow[c][s].store(&mut tile[c * padded + L * WIDE + s * LANES..]);
        }
    }
}
