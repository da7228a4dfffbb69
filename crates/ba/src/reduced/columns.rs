//! A sparse lower triangle in compressed columns.

use super::factorisation::Layout;
use crate::error::Error;
use crate::structure::Structure;

pub(crate) struct Columns {
    /// How many.
    pub(super) len: usize,
    pub(super) column_at: Vec<u32>,
    pub(super) row_of: Vec<u32>,
    /// First reduced column of each block, and the number of columns.
    pub(super) reduced: Vec<usize>,
    /// For each block column, the blocks in it, itself first, and the first row of each among the
    /// stored ones.
    below: Vec<Vec<(u32, u32)>>,
}

impl Columns {
    pub(crate) fn new(structure: &Structure) -> Result<Self, Error> {
        let blocks = &structure.blocks;
        let len = structure.columns;
        let reduced: Vec<usize> = blocks.iter().map(|block| block.reduced).chain([len]).collect();
        let mut below: Vec<Vec<(u32, u32)>> = vec![Vec::new(); blocks.len()];
        let mut heights = vec![0; blocks.len()];
        for (a, b) in structure.tile_pairs() {
            below[a as usize].push((b, heights[a as usize]));
            heights[a as usize] += blocks[b as usize].num_free() as u32;
        }
        let (mut column_at, mut row_of) = (vec![0u32], Vec::new());
        for (a, below) in below.iter().enumerate() {
            for column in 0..blocks[a].num_free() {
                for &(b, _) in below {
                    let skip = if b as usize == a { column } else { 0 };
                    row_of.extend(
                        (reduced[b as usize] + skip..reduced[b as usize + 1]).map(|row| row as u32),
                    );
                }
                if row_of.len() > u32::MAX as usize {
                    let (count, limit) = (row_of.len(), u32::MAX as usize);
                    return Err(Error::TooLarge {
                        what: "numbers in the reduced system",
                        count,
                        limit,
                    });
                }
                column_at.push(row_of.len() as u32);
            }
        }
        Ok(Self { len, column_at, row_of, reduced, below })
    }
}

impl Columns {
    /// How many numbers.
    pub(crate) fn num_numbers(&self) -> usize {
        self.row_of.len()
    }
}

impl Layout for Columns {
    fn block_column(&self, a: usize) -> std::ops::Range<usize> {
        self.column_at[self.reduced[a]] as usize..self.column_at[self.reduced[a + 1]] as usize
    }
    fn tile_at(&self, a: usize, b: usize, column: usize) -> usize {
        let first = self.reduced[a];
        let start = (self.column_at[first + column] - self.column_at[first]) as usize;
        let below = &self.below[a];
        let at = below
            .binary_search_by_key(&(b as u32), |below| below.0)
            .expect("every tile has its rows");
        // Column i of the block with itself lacks its first i rows.
        start + if a == b { 0 } else { below[at].1 as usize - column }
    }
}
