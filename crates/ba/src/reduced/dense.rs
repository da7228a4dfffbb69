//! A full matrix, column by column, and its Cholesky factorisation: right for up to some hundred
//! cameras.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::{MatMut, MatRef, Par};

use super::factorisation::{Factorisation, Layout, NotPositive};
use super::implicit::Eliminated;
use crate::structure::Structure;

pub(crate) struct Dense {
    columns: usize,
    /// First reduced column of each block, and the number of columns.
    reduced: Vec<usize>,
    memory: MemBuffer,
}

impl Dense {
    pub(crate) fn new(structure: &Structure) -> Self {
        let columns = structure.columns;
        let reduced = structure.blocks.iter().map(|block| block.reduced).chain([columns]).collect();
        let memory =
            MemBuffer::new(cholesky_in_place_scratch::<f64>(columns, Par::Seq, Default::default()));
        Self { columns, reduced, memory }
    }
}

impl Layout for Dense {
    fn block_column(&self, a: usize) -> std::ops::Range<usize> {
        self.reduced[a] * self.columns..self.reduced[a + 1] * self.columns
    }
    fn tile_at(&self, a: usize, b: usize, column: usize) -> usize {
        column * self.columns + self.reduced[b] + if a == b { column } else { 0 }
    }
}

impl Factorisation for Dense {
    fn factorise(&mut self, numbers: &mut Vec<f64>, _: Eliminated<'_>) -> Result<(), NotPositive> {
        let matrix = MatMut::from_column_major_slice_mut(numbers, self.columns, self.columns);
        let stack = MemStack::new(&mut self.memory);
        match cholesky_in_place(matrix, Default::default(), Par::Seq, stack, Default::default()) {
            Ok(_) => Ok(()),
            Err(LltError::NonPositivePivot { index }) => Err(NotPositive(index)),
        }
    }

    fn solve(&mut self, numbers: &[f64], _: Eliminated<'_>, x: &mut [f64], _: f64) {
        if self.columns == 0 {
            return;
        }
        let factor = MatRef::from_column_major_slice(numbers, self.columns, self.columns);
        let mut x = MatMut::from_column_major_slice_mut(x, self.columns, x.len() / self.columns);
        solve_lower_triangular_in_place(factor, x.as_mut(), Par::Seq);
        solve_upper_triangular_in_place(factor.transpose(), x, Par::Seq);
    }
}
