//! How numbers are laid out: rows of whole vectors, and tiles, the products of two blocks.

/// Numbers per row of storage: a multiple of the vector width that all instruction sets share.
pub(crate) fn padded(dof: usize) -> usize {
    dof.next_multiple_of(4)
}

/// Numbers in a column of a tile whose rows belong to a block of so many directions. Where one
/// direction is left over beside vectors of eight, it is not in the columns but has a row behind
/// them.
#[inline(always)]
pub(crate) fn tile_lanes(dof: usize) -> usize {
    if dof % 8 == 1 { dof - 1 } else { padded(dof) }
}

/// Numbers in a tile of blocks with so many directions.
#[inline(always)]
pub(crate) fn tile_len(a: usize, b: usize) -> usize {
    a * tile_lanes(b) + if tile_lanes(b) < b { padded(a) } else { 0 }
}

/// Where in such a tile a number is.
#[inline(always)]
pub(crate) fn tile_index(a: usize, b: usize, column: usize, row: usize) -> usize {
    let lanes = tile_lanes(b);
    if row < lanes { column * lanes + row } else { a * lanes + column }
}

/// A product of two blocks, a ≤ b: [`tile_len`] numbers, beginning at `at`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tile {
    pub(crate) a: u32,
    pub(crate) b: u32,
    pub(crate) at: usize,
}
