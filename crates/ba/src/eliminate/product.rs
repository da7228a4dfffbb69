//! Products of rows, the innermost loops: `tile ± aᵀb`.
//!
//! A tile of blocks a and b is stored by columns, one for each direction of a, of as many numbers as make whole vectors. Where b
//! has one direction more than fit into wide vectors, such as the nine of a camera with its lens, that one has a row of its own
//! behind the columns: one vector instead of one in each column. See [`tile_lanes`].

use super::lanes::{Isa, LANES, Vector, WIDE};
use crate::structure::{tile_lanes, tile_len};

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

/// Calls `f::<.., L, S>(first, ..)` for columns of `lanes` numbers: from number `first` on, `L` wide and `S` narrow vectors.
macro_rules! over_columns {
    ($lanes:expr, $f:ident::<$($n:ident),*>($($argument:expr),*)) => {
        match $lanes / LANES {
            0 => {}
            1 => $f::<$($n,)* 0, 1>(0, $($argument),*),
            2 => $f::<$($n,)* 1, 0>(0, $($argument),*),
            3 => $f::<$($n,)* 1, 1>(0, $($argument),*),
            4 => $f::<$($n,)* 2, 0>(0, $($argument),*),
            _ => {
                for first in (0..$lanes).step_by(LANES) {
                    $f::<$($n,)* 0, 1>(first, $($argument),*);
                }
            }
        }
    };
}

/// Splits a tile into its columns and the row behind them, which may be empty.
#[inline(always)]
fn split(tile: &mut [f64], a: usize, b: usize) -> (&mut [f64], &mut [f64]) {
    let (columns, rest) = tile.split_at_mut(a * tile_lanes(b));
    (columns, &mut rest[..tile_len(a, b) - a * tile_lanes(b)])
}

/// tile ± aᵀb with `N` rows each, of `dof_a` and `dof_b` numbers and some that do not matter.
#[inline(always)]
pub(super) fn product<I: Isa, const N: usize, const PLUS: bool>(
    a: &[&[f64]; N],
    b: &[&[f64]; N],
    dof_a: usize,
    dof_b: usize,
    tile: &mut [f64],
) {
    let lanes = tile_lanes(dof_b);
    let (columns, row) = split(tile, dof_a, dof_b);
    over_columns!(lanes, product_of::<I, N, PLUS>(a, b, lanes, columns));
    over_lanes!(row.len(), add_row::<I, N, PLUS>(a, b, dof_b - 1, row));
}

/// The same for `L` wide and `S` narrow vectors of each column, from number `first` on: those of b stay in registers.
#[inline(always)]
fn product_of<I: Isa, const N: usize, const PLUS: bool, const L: usize, const S: usize>(
    first: usize,
    a: &[&[f64]; N],
    b: &[&[f64]; N],
    lanes: usize,
    columns: &mut [f64],
) {
    // Loops and not `from_fn`, here and above: closures are not compiled for the instruction set.
    let (mut wide, mut narrow) = ([[I::Wide::splat(0.0); L]; N], [[I::Narrow::splat(0.0); S]; N]);
    load_rows::<N, L, S, I>(b, first, &mut wide, &mut narrow);
    let a = *a;
    for (j, column) in columns.chunks_exact_mut(lanes).enumerate() {
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

/// One vector of the row behind the columns: that of number `last` of b.
#[inline(always)]
fn add_row<V: Vector, const N: usize, const PLUS: bool>(
    lane: usize,
    a: &[&[f64]; N],
    b: &[&[f64]; N],
    last: usize,
    row: &mut [f64],
) {
    let to = &mut row[lane..];
    let mut sum = V::load(to);
    for k in 0..N {
        let (a, b) = (V::load(&a[k][lane..]), V::splat(b[k][last]));
        sum = if PLUS { b.mul_add(a, sum) } else { b.neg_mul_add(a, sum) };
    }
    sum.store(to);
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

/// Columns of a matrix of rows of `width` numbers.
#[derive(Clone, Copy)]
pub(super) struct Of {
    /// The first of them.
    pub(super) column: usize,
    pub(super) dof: usize,
}

/// tile − aᵀb over all rows of `w`, of which a and b are columns: the sums stay in registers meanwhile.
#[inline(always)]
pub(super) fn subtract_product<I: Isa>(w: &[f64], width: usize, a: Of, b: Of, tile: &mut [f64]) {
    if I::MANY_REGISTERS && (a.dof, b.dof) == (9, 9) {
        return subtract_nine::<I>(w, width, a.column, b.column, tile);
    }
    let lanes = tile_lanes(b.dof);
    let (columns, row) = split(tile, a.dof, b.dof);
    over_columns!(lanes, subtract_columns::<I>(w, width, a.column, b.column, lanes, columns));
    over_lanes!(row.len(), subtract_row::<I>(w, width, a.column, b.column + b.dof - 1, row));
}

/// All of a tile of cameras with their lenses at once.
#[inline(always)]
fn subtract_nine<I: Isa>(w: &[f64], width: usize, a: usize, b: usize, tile: &mut [f64]) {
    let tile: &mut [f64; 9 * WIDE + 9] = tile.first_chunk_mut().expect("tiles are as long as that");
    let (mut columns, mut row) = ([I::Wide::splat(0.0); 9], I::Wide::load(&tile[9 * WIDE..]));
    let mut last = tile[9 * WIDE + WIDE];
    for c in 0..9 {
        columns[c] = I::Wide::load(&tile[c * WIDE..]);
    }
    for numbers in w.chunks_exact(width) {
        let a: &[f64; 9] = numbers[a..].first_chunk().expect("rows hold all columns of a");
        let b: &[f64; 9] = numbers[b..].first_chunk().expect("rows hold all columns of b");
        let wide = I::Wide::load(b);
        for c in 0..9 {
            columns[c] = I::Wide::splat(a[c]).neg_mul_add(wide, columns[c]);
        }
        row = I::Wide::splat(b[WIDE]).neg_mul_add(I::Wide::load(a), row);
        last = I::mul_add_one(-a[WIDE], b[WIDE], last);
    }
    for c in 0..9 {
        columns[c].store(&mut tile[c * WIDE..]);
    }
    row.store(&mut tile[9 * WIDE..]);
    tile[9 * WIDE + WIDE] = last;
}

/// One vector of the row behind the columns.
#[inline(always)]
fn subtract_row<V: Vector>(lane: usize, w: &[f64], width: usize, a: usize, last: usize, row: &mut [f64]) {
    let to = &mut row[lane..];
    let mut sum = V::load(to);
    for row in w.chunks_exact(width) {
        sum = V::splat(row[last]).neg_mul_add(V::load(&row[a + lane..]), sum);
    }
    sum.store(to);
}

/// As many columns at once as have their sums, `L` + `S` vectors each, in registers.
#[inline(always)]
fn subtract_columns<I: Isa, const L: usize, const S: usize>(
    first: usize,
    w: &[f64],
    width: usize,
    a: usize,
    b: usize,
    lanes: usize,
    columns: &mut [f64],
) {
    let (mut columns, mut a, b) = (columns, a, b + first);
    if I::MANY_REGISTERS {
        while columns.len() > 8 * lanes {
            let (these, rest) = columns.split_at_mut((9 * lanes).min(columns.len()));
            subtract_some::<9, L, S, I>(w, width, a, b, lanes, &mut these[first..]);
            (columns, a) = (rest, a + 9);
        }
        while columns.len() > 5 * lanes {
            let (these, rest) = columns.split_at_mut((6 * lanes).min(columns.len()));
            subtract_some::<6, L, S, I>(w, width, a, b, lanes, &mut these[first..]);
            (columns, a) = (rest, a + 6);
        }
    }
    while columns.len() > 2 * lanes {
        let (these, rest) = columns.split_at_mut((3 * lanes).min(columns.len()));
        subtract_some::<3, L, S, I>(w, width, a, b, lanes, &mut these[first..]);
        (columns, a) = (rest, a + 3);
    }
    while !columns.is_empty() {
        let (these, rest) = columns.split_at_mut(lanes.min(columns.len()));
        subtract_some::<1, L, S, I>(w, width, a, b, lanes, &mut these[first..]);
        (columns, a) = (rest, a + 1);
    }
}

#[inline(always)]
fn subtract_some<const C: usize, const L: usize, const S: usize, I: Isa>(
    w: &[f64],
    width: usize,
    a: usize,
    b: usize,
    lanes: usize,
    columns: &mut [f64],
) {
    let (mut wide, mut narrow) = ([[I::Wide::splat(0.0); L]; C], [[I::Narrow::splat(0.0); S]; C]);
    for c in 0..C {
        for l in 0..L {
            wide[c][l] = I::Wide::load(&columns[c * lanes + l * WIDE..]);
        }
        for s in 0..S {
            narrow[c][s] = I::Narrow::load(&columns[c * lanes + L * WIDE + s * LANES..]);
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
            wide[c][l].store(&mut columns[c * lanes + l * WIDE..]);
        }
        for s in 0..S {
            narrow[c][s].store(&mut columns[c * lanes + L * WIDE + s * LANES..]);
        }
    }
}
