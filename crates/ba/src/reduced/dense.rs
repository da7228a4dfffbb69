//! Full matrix in column-major order and its Cholesky factorisation, for up to some hundred
//! cameras.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::{MatMut, MatRef, Par};

use super::factorisation::{Factorisation, Layout, NotPositive};
use super::implicit::EliminatedSystem;
use crate::structure::Structure;

pub(crate) struct Dense {
    columns: usize,
    /// First column of each block, then the number of columns.
    first_column: Vec<usize>,
    memory: MemBuffer,
}

impl Dense {
    pub(crate) fn new(structure: &Structure) -> Self {
        let columns = structure.columns;
        let first_column =
            structure.blocks.iter().map(|block| block.first_column).chain([columns]).collect();
        let memory =
            MemBuffer::new(cholesky_in_place_scratch::<f64>(columns, Par::Seq, Default::default()));
        Self { columns, first_column, memory }
    }
}

impl Layout for Dense {
    fn block_column(&self, a: usize) -> std::ops::Range<usize> {
        self.first_column[a] * self.columns..self.first_column[a + 1] * self.columns
    }
    fn tile_at(&self, a: usize, b: usize, column: usize) -> usize {
        column * self.columns + self.first_column[b] + if a == b { column } else { 0 }
    }
}

impl Factorisation for Dense {
    fn factorise(
        &mut self,
        lower: &mut Vec<f64>,
        _: EliminatedSystem<'_>,
    ) -> Result<(), NotPositive> {
        let matrix = MatMut::from_column_major_slice_mut(lower, self.columns, self.columns);
        let stack = MemStack::new(&mut self.memory);
        match cholesky_in_place(matrix, Default::default(), Par::Seq, stack, Default::default()) {
            Ok(_) => Ok(()),
            Err(LltError::NonPositivePivot { index }) => Err(NotPositive(index)),
        }
    }

    fn solve(&mut self, lower: &[f64], _: EliminatedSystem<'_>, x: &mut [f64], _: f64) {
        if self.columns == 0 {
            return;
        }
        let factor = MatRef::from_column_major_slice(lower, self.columns, self.columns);
        let mut x = MatMut::from_column_major_slice_mut(x, self.columns, x.len() / self.columns);
        solve_lower_triangular_in_place(factor, x.as_mut(), Par::Seq);
        solve_upper_triangular_in_place(factor.transpose(), x, Par::Seq);
    }
}
