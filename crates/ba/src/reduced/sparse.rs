//! A sparse lower triangle in compressed columns, and faer's supernodal Cholesky factorisation.
//!
//! The order of elimination is that of the blocks (time, then shared ones) or approximate minimum degree, whichever leaves the
//! smaller factor. The symbolic work is done once.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltError;
use faer::perm::PermRef;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};

use super::{Factorisation, Layout, NotPositive};
use crate::error::Error;
use crate::structure::Structure;

pub(crate) struct Sparse {
    columns: usize,
    column_at: Vec<u32>,
    row_of: Vec<u32>,
    /// First reduced column of each block, and the number of columns.
    reduced: Vec<usize>,
    /// For each block column, the blocks in it, itself first, and the first row of each among the stored ones.
    below: Vec<Vec<(u32, u32)>>,
    symbolic: SymbolicCholesky<u32>,
    factor: Vec<f64>,
    memory: MemBuffer,
}

impl Sparse {
    pub(crate) fn new(structure: &Structure) -> Result<Self, Error> {
        let blocks = &structure.blocks;
        let columns = structure.columns;
        let reduced: Vec<usize> = blocks.iter().map(|block| block.reduced).chain([columns]).collect();
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
                    row_of
                        .extend((reduced[b as usize] + skip..reduced[b as usize + 1]).map(|row| row as u32));
                }
                if row_of.len() > u32::MAX as usize {
                    let (count, limit) = (row_of.len(), u32::MAX as usize);
                    return Err(Error::TooLarge { what: "numbers in the reduced system", count, limit });
                }
                column_at.push(row_of.len() as u32);
            }
        }
        let symbolic = {
            let pattern = SymbolicSparseColMatRef::new_checked(columns, columns, &column_at, None, &row_of);
            symbolic(pattern, columns)?
        };
        let factor = vec![0.0; symbolic.len_val()];
        let memory = MemBuffer::new(
            symbolic
                .factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default())
                .or(symbolic.solve_in_place_scratch::<f64>(1, Par::Seq)),
        );
        Ok(Self { columns, column_at, row_of, reduced, below, symbolic, factor, memory })
    }
}

fn symbolic(
    pattern: SymbolicSparseColMatRef<'_, u32>,
    columns: usize,
) -> Result<SymbolicCholesky<u32>, Error> {
    let natural: Vec<u32> = (0..columns as u32).collect();
    let natural = PermRef::new_checked(&natural, &natural, columns);
    let factorise = |ordering| {
        factorize_symbolic_cholesky(pattern, Side::Lower, ordering, CholeskySymbolicParams::default())
            .map_err(|_| Error::TooLarge {
                what: "numbers in the factor",
                count: usize::MAX,
                limit: u32::MAX as usize,
            })
    };
    let by_degree = factorise(SymmetricOrdering::Amd);
    let in_order = factorise(SymmetricOrdering::Custom(natural));
    match (by_degree, in_order) {
        (Ok(a), Ok(b)) => Ok(if a.len_val() < b.len_val() { a } else { b }),
        (Ok(a), Err(_)) => Ok(a),
        (Err(_), b) => b,
    }
}

impl Layout for Sparse {
    fn block_column(&self, a: usize) -> std::ops::Range<usize> {
        self.column_at[self.reduced[a]] as usize..self.column_at[self.reduced[a + 1]] as usize
    }
    fn tile_at(&self, a: usize, b: usize, column: usize) -> usize {
        let first = self.reduced[a];
        let start = (self.column_at[first + column] - self.column_at[first]) as usize;
        let below = &self.below[a];
        let at = below.binary_search_by_key(&(b as u32), |below| below.0).expect("every tile has its rows");
        // Column i of the block with itself lacks its first i rows.
        start + if a == b { 0 } else { below[at].1 as usize - column }
    }
}

impl Factorisation for Sparse {
    fn factorise(&mut self, numbers: &mut Vec<f64>) -> Result<(), NotPositive> {
        let pattern = SymbolicSparseColMatRef::new_checked(
            self.columns,
            self.columns,
            &self.column_at,
            None,
            &self.row_of,
        );
        let matrix = SparseColMatRef::new(pattern, &numbers[..]);
        let stack = MemStack::new(&mut self.memory);
        let factor = &mut self.factor;
        match self.symbolic.factorize_numeric_llt(
            factor,
            matrix,
            Side::Lower,
            Default::default(),
            Par::Seq,
            stack,
            Default::default(),
        ) {
            Ok(_) => Ok(()),
            Err(LltError::NonPositivePivot { index }) => Err(NotPositive(index)),
        }
    }

    fn solve(&mut self, _: &[f64], x: &mut [f64]) {
        let factor = LltRef::new(&self.symbolic, &self.factor);
        let stack = MemStack::new(&mut self.memory);
        for x in x.chunks_exact_mut(self.columns) {
            let x = MatMut::from_column_major_slice_mut(x, self.columns, 1);
            factor.solve_in_place_with_conj(Conj::No, x, Par::Seq, stack);
        }
    }
}
