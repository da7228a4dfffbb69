//! Memory layout: rows padded to whole vectors, and tiles, the products of two column blocks.

/// Padded length of a row: a multiple of the vector width that all instruction sets have.
pub(crate) fn padded(dof: usize) -> usize {
    dof.next_multiple_of(4)
}

/// Length of a tile's columns, whose rows belong to a block of `dof` directions. If `dof` is one
/// more than a multiple of eight, the last row is not in the columns but is stored behind them.
#[inline(always)]
pub(crate) fn tile_lanes(dof: usize) -> usize {
    if dof % 8 == 1 { dof - 1 } else { padded(dof) }
}

/// Length of a tile of blocks with `a` and `b` directions.
#[inline(always)]
pub(crate) fn tile_len(a: usize, b: usize) -> usize {
    a * tile_lanes(b) + if tile_lanes(b) < b { padded(a) } else { 0 }
}

/// Index of an element in such a tile.
#[inline(always)]
pub(crate) fn tile_index(a: usize, b: usize, column: usize, row: usize) -> usize {
    let lanes = tile_lanes(b);
    if row < lanes { column * lanes + row } else { a * lanes + column }
}

/// A product of two blocks, a ≤ b: [`tile_len`] numbers from `at` on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tile {
    pub(crate) a: u32,
    pub(crate) b: u32,
    pub(crate) at: usize,
}
