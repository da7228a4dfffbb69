//! Supernodal sparse Cholesky factorisation, by faer.
//!
//! The elimination order is that of the blocks (time, then shared variables) or approximate minimum
//! degree, whichever has the smaller factor. The symbolic factorisation is computed once.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltError;
use faer::perm::PermRef;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};

use super::columns::Columns;
use super::factorisation::{Factorisation, Layout, NotPositive};
use super::implicit::EliminatedSystem;

/// Largest factor, in elements: 4 GiB.
const MAX_FACTOR: usize = 1 << 29;

pub(crate) struct Sparse {
    columns: Columns,
    symbolic: SymbolicCholesky<u32>,
    factor: Vec<f64>,
    memory: MemBuffer,
}

impl Sparse {
    /// Returns the columns as an error if the factor would be larger than [`MAX_FACTOR`].
    pub(crate) fn new(columns: Columns) -> Result<Self, Columns> {
        let Columns { len, column_at, row_of, .. } = &columns;
        let pattern = SymbolicSparseColMatRef::new_checked(*len, *len, column_at, None, row_of);
        let Some(symbolic) =
            symbolic(pattern, *len).filter(|symbolic| symbolic.len_val() <= MAX_FACTOR)
        else {
            return Err(columns);
        };
        let factor = vec![0.0; symbolic.len_val()];
        let memory = MemBuffer::new(
            symbolic
                .factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default())
                .or(symbolic.solve_in_place_scratch::<f64>(1, Par::Seq)),
        );
        Ok(Self { columns, symbolic, factor, memory })
    }
}

/// `None` if the size of the factor overflows.
fn symbolic(
    pattern: SymbolicSparseColMatRef<'_, u32>,
    columns: usize,
) -> Option<SymbolicCholesky<u32>> {
    let natural: Vec<u32> = (0..columns as u32).collect();
    let natural = PermRef::new_checked(&natural, &natural, columns);
    let factorise = |ordering| {
        factorize_symbolic_cholesky(
            pattern,
            Side::Lower,
            ordering,
            CholeskySymbolicParams::default(),
        )
        .ok()
    };
    let by_degree = factorise(SymmetricOrdering::Amd);
    let in_order = factorise(SymmetricOrdering::Custom(natural));
    by_degree.into_iter().chain(in_order).min_by_key(SymbolicCholesky::len_val)
}

impl Layout for Sparse {
    fn block_column(&self, a: usize) -> std::ops::Range<usize> {
        self.columns.block_column(a)
    }
    fn tile_at(&self, a: usize, b: usize, column: usize) -> usize {
        self.columns.tile_at(a, b, column)
    }
}

impl Factorisation for Sparse {
    fn factorise(
        &mut self,
        lower: &mut Vec<f64>,
        _: EliminatedSystem<'_>,
    ) -> Result<(), NotPositive> {
        let pattern = SymbolicSparseColMatRef::new_checked(
            self.columns.len,
            self.columns.len,
            &self.columns.column_at,
            None,
            &self.columns.row_of,
        );
        let matrix = SparseColMatRef::new(pattern, &lower[..]);
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

    fn solve(&mut self, _: &[f64], _: EliminatedSystem<'_>, x: &mut [f64], _: f64) {
        let factor = LltRef::new(&self.symbolic, &self.factor);
        let stack = MemStack::new(&mut self.memory);
        for x in x.chunks_exact_mut(self.columns.len.max(1)) {
            let x = MatMut::from_column_major_slice_mut(x, self.columns.len, 1);
            factor.solve_in_place_with_conj(Conj::No, x, Par::Seq, stack);
        }
    }
}
