//! The lower triangle of the reduced system as a sparse matrix in compressed columns (CSC).

use super::factorisation::Layout;
use crate::error::Error;
use crate::structure::Structure;

pub(crate) struct Columns {
    /// Number of columns.
    pub(super) len: usize,
    /// Index of the first stored element of each column, then the number of stored elements.
    pub(super) column_at: Vec<u32>,
    /// Row of each stored element.
    pub(super) row_of: Vec<u32>,
    /// First column of each block, then the number of columns.
    pub(super) first_column: Vec<usize>,
    /// For each block column: its blocks, from the diagonal down, and the first row of each among
    /// the stored rows.
    below: Vec<Vec<(u32, u32)>>,
}

impl Columns {
    pub(crate) fn new(structure: &Structure) -> Result<Self, Error> {
        let blocks = &structure.blocks;
        let len = structure.columns;
        let first_column: Vec<usize> =
            blocks.iter().map(|block| block.first_column).chain([len]).collect();
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
                        (first_column[b as usize] + skip..first_column[b as usize + 1])
                            .map(|row| row as u32),
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
        Ok(Self { len, column_at, row_of, first_column, below })
    }
}

impl Columns {
    /// Number of stored elements.
    pub(crate) fn num_numbers(&self) -> usize {
        self.row_of.len()
    }
}

impl Layout for Columns {
    fn block_column(&self, a: usize) -> std::ops::Range<usize> {
        self.column_at[self.first_column[a]] as usize
            ..self.column_at[self.first_column[a + 1]] as usize
    }
    fn tile_at(&self, a: usize, b: usize, column: usize) -> usize {
        let first = self.first_column[a];
        let start = (self.column_at[first + column] - self.column_at[first]) as usize;
        let below = &self.below[a];
        let at = below
            .binary_search_by_key(&(b as u32), |below| below.0)
            .expect("every tile has its rows");
        // Column i of a diagonal block lacks its first i rows.
        start + if a == b { 0 } else { below[at].1 as usize - column }
    }
}
