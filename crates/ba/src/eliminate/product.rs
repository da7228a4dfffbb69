//! Matrix products in the innermost loops: `tile ± aᵀb`.
//!
//! A tile of blocks a and b is stored by columns, one for each direction of a, padded to whole
//! vectors. If b has one direction more than a multiple of [`WIDE`], such as the nine of a pose
//! with intrinsics, its last direction is stored as a row behind the columns: one vector instead of
//! one in each column. See [`tile_lanes`].

use super::simd::{Isa, Kernel, LANES, Vector, WIDE};
use crate::structure::{PatternBlock, tile_lanes, tile_len};

/// Calls `f::<V, ..>(i, ..)` for the vectors of a row of `len` numbers, a multiple of [`LANES`]: V
/// is the widest vector that fits from number i on.
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

/// Calls `f::<.., L, S>(first, ..)` for columns of `lanes` numbers: `L` wide and `S` narrow vectors
/// from number `first` on.
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

/// tile += aᵀb, where a and b have `N` rows, of `dof_a` and `dof_b` numbers and padding.
#[inline(always)]
pub(super) fn product<I: Isa, const N: usize>(
    a: &[&[f64]; N],
    b: &[&[f64]; N],
    dof_a: usize,
    dof_b: usize,
    tile: &mut [f64],
) {
    let lanes = tile_lanes(dof_b);
    let (columns, row) = split(tile, dof_a, dof_b);
    over_columns!(lanes, product_of::<I, N>(a, b, lanes, columns));
    over_lanes!(row.len(), add_row::<I, N>(a, b, dof_b - 1, row));
}

/// tile += aᵀb for `L` wide and `S` narrow vectors of each column, from number `first` on. The rows
/// of b stay in registers.
#[inline(always)]
fn product_of<I: Isa, const N: usize, const L: usize, const S: usize>(
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
            add_column::<N, I::Wide, L>(&a, j, &wide, l, &mut column[l * WIDE..]);
        }
        for s in 0..S {
            add_column::<N, I::Narrow, S>(&a, j, &narrow, s, &mut rest[s * LANES..]);
        }
    }
}

/// tile += aᵀb for one vector of one column.
#[inline(always)]
fn add_column<const N: usize, V: Vector, const L: usize>(
    a: &[&[f64]; N],
    j: usize,
    b: &[[V; L]; N],
    l: usize,
    to: &mut [f64],
) {
    let mut sum = V::load(to);
    for k in 0..N {
        sum = V::splat(a[k][j]).mul_add(b[k][l], sum);
    }
    sum.store(to);
}

/// tile += aᵀb for one vector of the row behind the columns, which belongs to column `last` of b.
#[inline(always)]
fn add_row<V: Vector, const N: usize>(
    lane: usize,
    a: &[&[f64]; N],
    b: &[&[f64]; N],
    last: usize,
    row: &mut [f64],
) {
    let to = &mut row[lane..];
    let mut sum = V::load(to);
    for k in 0..N {
        sum = V::splat(b[k][last]).mul_add(V::load(&a[k][lane..]), sum);
    }
    sum.store(to);
}

/// Loads `L` wide and then `S` narrow vectors of each row, from element `first` on.
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

/// A range of columns.
#[derive(Clone, Copy)]
pub(super) struct ColumnSpan {
    /// The first one.
    pub(super) column: usize,
    pub(super) dof: usize,
}

impl ColumnSpan {
    /// The columns of a block in rows over the blocks of its pattern.
    #[inline(always)]
    fn of(block: &PatternBlock) -> Self {
        Self { column: block.padded_offset, dof: block.dof }
    }
}

/// Rows that start at the given offsets. Each extends to the end of `numbers`.
#[derive(Clone)]
pub(crate) struct GatheredRows<'a> {
    pub(super) numbers: &'a [f64],
    pub(super) starts: std::slice::Iter<'a, u32>,
}

impl<'a> Iterator for GatheredRows<'a> {
    type Item = &'a [f64];
    #[inline(always)]
    fn next(&mut self) -> Option<&'a [f64]> {
        match self.starts.next() {
            Some(&start) => Some(&self.numbers[start as usize..]),
            None => None,
        }
    }
}

/// Subtracts YᵀY of the first of some blocks with itself and with the others from their tiles.
pub(super) struct SubtractProducts<'a> {
    /// Y: rows over the blocks of a pattern, `width` apart.
    pub(super) y: &'a [f64],
    pub(super) width: usize,
    pub(super) blocks: &'a [PatternBlock],
    /// The offset of each block's tile in `tiles`.
    pub(super) tile_at: &'a [u32],
    pub(super) tiles: &'a mut [f64],
}

impl Kernel for SubtractProducts<'_> {
    #[inline(always)]
    fn run<I: Isa>(self) {
        let Self { y, width, blocks, tile_at, tiles } = self;
        let (rows, a) = (y.chunks_exact(width), ColumnSpan::of(&blocks[0]));
        let others = blocks.iter().zip(tile_at);
        if I::MANY_REGISTERS && a.dof == POSE && y.len() == POINT * width {
            let three = [&y[..width], &y[width..2 * width], &y[2 * width..]];
            let factors = PoseOfPoint::<I::Wide>::new(&three, a.column);
            for (b, &at) in others {
                let tile = &mut tiles[at as usize..];
                if b.padded == WIDE {
                    factors.subtract(&three, b.padded_offset, tile);
                } else {
                    sum_product::<I, false>(rows.clone(), a, ColumnSpan::of(b), tile);
                }
            }
            return;
        }
        for (b, &at) in others {
            let tile = &mut tiles[at as usize..];
            sum_product::<I, false>(rows.clone(), a, ColumnSpan::of(b), tile);
        }
    }
}

/// Degrees of freedom of a pose and of a point.
const POSE: usize = 6;
pub(super) const POINT: usize = 3;

/// Y of one point and one pose, each number in a vector of its own: most of the work of a
/// reconstruction whose images share intrinsics. They stay in registers for all tiles of the pose.
struct PoseOfPoint<V>([[V; POSE]; POINT]);

impl<V: Vector> PoseOfPoint<V> {
    #[inline(always)]
    fn new(rows: &[&[f64]; POINT], column: usize) -> Self {
        let mut factors = [[V::splat(0.0); POSE]; POINT];
        for k in 0..POINT {
            for c in 0..POSE {
                factors[k][c] = V::splat(rows[k][column + c]);
            }
        }
        Self(factors)
    }

    /// Subtracts the product with the block from `column` on, whose columns are one vector.
    #[inline(always)]
    fn subtract(&self, rows: &[&[f64]; POINT], column: usize, tile: &mut [f64]) {
        let tile: &mut [f64; POSE * WIDE] =
            tile.first_chunk_mut().expect("tiles are as long as that");
        let mut b = [V::splat(0.0); POINT];
        for (b, row) in b.iter_mut().zip(rows) {
            *b = V::load(&row[column..]);
        }
        for c in 0..POSE {
            let mut sum = V::load(&tile[c * WIDE..]);
            for (row, b) in self.0.iter().zip(b) {
                sum = row[c].neg_mul_add(b, sum);
            }
            sum.store(&mut tile[c * WIDE..]);
        }
    }
}

/// Adds aᵀb over all `rows` to a tile.
pub(super) struct SumProduct<'a, R> {
    pub(super) rows: R,
    pub(super) a: ColumnSpan,
    pub(super) b: ColumnSpan,
    pub(super) tile: &'a mut [f64],
}

impl<'a, R: Iterator<Item = &'a [f64]> + Clone> Kernel for SumProduct<'_, R> {
    #[inline(always)]
    fn run<I: Isa>(self) {
        sum_product::<I, true>(self.rows, self.a, self.b, self.tile);
    }
}

/// tile ± aᵀb over all `rows`, where a and b are ranges of their columns. The sums stay in
/// registers.
#[inline(always)]
pub(super) fn sum_product<'a, I: Isa, const PLUS: bool>(
    rows: impl Iterator<Item = &'a [f64]> + Clone,
    a: ColumnSpan,
    b: ColumnSpan,
    tile: &mut [f64],
) {
    if I::MANY_REGISTERS && (a.dof, b.dof) == (9, 9) {
        return sum_nine::<I, PLUS>(rows, a.column, b.column, tile);
    }
    let lanes = tile_lanes(b.dof);
    let (columns, row) = split(tile, a.dof, b.dof);
    match lanes / LANES {
        0 => {}
        1 => sum_columns::<I, PLUS, 0, 1>(0, rows.clone(), a.column, b.column, lanes, columns),
        2 => sum_columns::<I, PLUS, 1, 0>(0, rows.clone(), a.column, b.column, lanes, columns),
        3 => sum_columns::<I, PLUS, 1, 1>(0, rows.clone(), a.column, b.column, lanes, columns),
        4 => sum_columns::<I, PLUS, 2, 0>(0, rows.clone(), a.column, b.column, lanes, columns),
        _ => {
            for first in (0..lanes).step_by(LANES) {
                sum_columns::<I, PLUS, 0, 1>(
                    first,
                    rows.clone(),
                    a.column,
                    b.column,
                    lanes,
                    columns,
                );
            }
        }
    }
    for lane in (0..row.len()).step_by(LANES) {
        sum_row::<I, PLUS>(lane, rows.clone(), a.column, b.column + b.dof - 1, row);
    }
}

/// sum ± ab.
#[inline(always)]
fn add_or_subtract<V: Vector, const PLUS: bool>(sum: V, a: V, b: V) -> V {
    if PLUS { a.mul_add(b, sum) } else { a.neg_mul_add(b, sum) }
}

/// [`sum_product`] of a whole 9 × 9 tile (pose with three intrinsics) at once.
#[inline(always)]
fn sum_nine<'a, I: Isa, const PLUS: bool>(
    rows: impl Iterator<Item = &'a [f64]> + Clone,
    a: usize,
    b: usize,
    tile: &mut [f64],
) {
    let tile: &mut [f64; 9 * WIDE + 9] = tile.first_chunk_mut().expect("tiles are as long as that");
    let (mut columns, mut row) = ([I::Wide::splat(0.0); 9], I::Wide::load(&tile[9 * WIDE..]));
    let mut last = tile[9 * WIDE + WIDE];
    for c in 0..9 {
        columns[c] = I::Wide::load(&tile[c * WIDE..]);
    }
    for numbers in rows {
        let a: &[f64; 9] = numbers[a..].first_chunk().expect("rows hold all columns of a");
        let b: &[f64; 9] = numbers[b..].first_chunk().expect("rows hold all columns of b");
        let wide = I::Wide::load(b);
        for c in 0..9 {
            columns[c] = add_or_subtract::<_, PLUS>(columns[c], I::Wide::splat(a[c]), wide);
        }
        row = add_or_subtract::<_, PLUS>(row, I::Wide::splat(b[WIDE]), I::Wide::load(a));
        last = I::mul_add_one(if PLUS { a[WIDE] } else { -a[WIDE] }, b[WIDE], last);
    }
    for c in 0..9 {
        columns[c].store(&mut tile[c * WIDE..]);
    }
    row.store(&mut tile[9 * WIDE..]);
    tile[9 * WIDE + WIDE] = last;
}

/// One vector of the row behind the columns.
#[inline(always)]
fn sum_row<'a, I: Isa, const PLUS: bool>(
    lane: usize,
    rows: impl Iterator<Item = &'a [f64]> + Clone,
    a: usize,
    last: usize,
    row: &mut [f64],
) {
    let to = &mut row[lane..];
    let mut sum = I::Narrow::load(to);
    for row in rows {
        let (a, b) = (I::Narrow::load(&row[a + lane..]), I::Narrow::splat(row[last]));
        sum = add_or_subtract::<_, PLUS>(sum, b, a);
    }
    sum.store(to);
}

/// As many columns at once as have their sums, `L` + `S` vectors each, in registers.
#[inline(always)]
fn sum_columns<'a, I: Isa, const PLUS: bool, const L: usize, const S: usize>(
    first: usize,
    rows: impl Iterator<Item = &'a [f64]> + Clone,
    a: usize,
    b: usize,
    lanes: usize,
    columns: &mut [f64],
) {
    let (mut columns, mut a, b) = (columns, a, b + first);
    if I::MANY_REGISTERS {
        while columns.len() > 8 * lanes {
            let (these, rest) = columns.split_at_mut((9 * lanes).min(columns.len()));
            sum_some::<9, L, S, PLUS, I>(rows.clone(), a, b, lanes, &mut these[first..]);
            (columns, a) = (rest, a + 9);
        }
        while columns.len() > 5 * lanes {
            let (these, rest) = columns.split_at_mut((6 * lanes).min(columns.len()));
            sum_some::<6, L, S, PLUS, I>(rows.clone(), a, b, lanes, &mut these[first..]);
            (columns, a) = (rest, a + 6);
        }
    }
    while columns.len() > 2 * lanes {
        let (these, rest) = columns.split_at_mut((3 * lanes).min(columns.len()));
        sum_some::<3, L, S, PLUS, I>(rows.clone(), a, b, lanes, &mut these[first..]);
        (columns, a) = (rest, a + 3);
    }
    while !columns.is_empty() {
        let (these, rest) = columns.split_at_mut(lanes.min(columns.len()));
        sum_some::<1, L, S, PLUS, I>(rows.clone(), a, b, lanes, &mut these[first..]);
        (columns, a) = (rest, a + 1);
    }
}

#[inline(always)]
fn sum_some<'a, const C: usize, const L: usize, const S: usize, const PLUS: bool, I: Isa>(
    rows: impl Iterator<Item = &'a [f64]> + Clone,
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
    for row in rows {
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
                wide[c][l] =
                    add_or_subtract::<_, PLUS>(wide[c][l], I::Wide::splat(a[c]), b_wide[l]);
            }
            for s in 0..S {
                narrow[c][s] =
                    add_or_subtract::<_, PLUS>(narrow[c][s], I::Narrow::splat(a[c]), b_narrow[s]);
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
