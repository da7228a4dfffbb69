//! How well variables are determined: blocks of (JᵀJ)⁻¹ at the current values.
//!
//! A step of the eliminated variable p follows that of the kept ones as δ_p = A_p δ_c with A_p =
//! −L⁻ᵀY (see `eliminate`), so with the reduced system S and A the selection of columns for a kept
//! variable, `cov(a, b) = A_a S⁻¹ A_bᵀ`, and `(LLᵀ)⁻¹` on top where a and b are the same eliminated
//! variable.

use nalgebra::DMatrix;

use crate::eliminate::CellStash;
use crate::error::Error;
use crate::options::LinearSolver;
use crate::problem::Problem;
use crate::reduced::Eliminated;
use crate::schur::SchurSystem;
use crate::structure::{Cell, NONE};
use crate::summary::Times;
use crate::system::System;
use crate::variable::{AnyKey, Role};

/// A direction whose variance is larger than it would be were all other variables known by this
/// factor is not determined: of the 16 digits of a double, the condition number has eaten 13.
const MAX_INFLATION: f64 = 1e13;

/// Covariances of some variables, in tangent coordinates. Right when the factors' residuals have
/// unit variance and their losses are trivial, or nearly.
#[derive(Clone, Debug, PartialEq)]
pub struct Covariance {
    keys: Vec<AnyKey>,
    first: Vec<usize>,
    matrix: DMatrix<f64>,
}

impl Covariance {
    /// Of one variable.
    pub fn of(&self, key: impl Into<AnyKey>) -> Option<DMatrix<f64>> {
        let key = key.into();
        self.between(key, key)
    }

    /// Of two variables: rows belong to `a`.
    pub fn between(&self, a: impl Into<AnyKey>, b: impl Into<AnyKey>) -> Option<DMatrix<f64>> {
        let range = |key: AnyKey| {
            let at = self.keys.iter().position(|other| *other == key)?;
            Some((self.first[at], self.first[at + 1] - self.first[at]))
        };
        let ((row, rows), (column, columns)) = (range(a.into())?, range(b.into())?);
        Some(self.matrix.view((row, column), (rows, columns)).into_owned())
    }

    /// Of all variables that were asked for, side by side.
    pub fn matrix(&self) -> &DMatrix<f64> {
        &self.matrix
    }
}

impl Problem {
    /// The covariance of some variables at the current values. Directions that are fixed have none:
    /// zeros.
    pub fn covariance(&self, keys: &[AnyKey]) -> Result<Covariance, Error> {
        let mut first = vec![0];
        for key in keys {
            let (store, _) = self.locate(key)?;
            first.push(first[first.len() - 1] + self.values.stores[store].dof());
        }
        let mut system = SchurSystem::new(self, LinearSolver::Auto, 0)?;
        let linearised = system.linearize(self, &self.values, 0.0, &mut Times::default());
        linearised.check_finite(self)?;
        let columns = system.structure.columns;
        let undetermined =
            |key: &AnyKey| Error::Undetermined { variable: key.type_name, slot: key.slot };
        let Some(first_key) = keys.first() else {
            return Ok(Covariance { keys: Vec::new(), first, matrix: DMatrix::zeros(0, 0) });
        };
        // All of the system has to be solvable, wherever the trouble is.
        let rest = Eliminated { structure: &system.structure, memory: &system.memory };
        system.reduced.factorise(rest).map_err(|_| undetermined(first_key))?;
        let mut parts = Parts::new(columns, first[keys.len()]);
        for (key, &at) in keys.iter().zip(&first) {
            let (store, slot) = self.locate(key)?;
            let meta = self.metas[store][slot];
            let is_determined = if meta.role == Role::Eliminated && meta.free != 0 {
                parts.add_eliminated(&system, (store, slot), meta.free, at)
            } else {
                parts.add_kept(&system, (store, slot), self.values.stores[store].dof(), at)
            };
            is_determined.ok_or_else(|| undetermined(key))?;
        }
        let Parts { a, own, information } = parts;
        let mut x = a.clone();
        system.reduced.solve_columns(rest, x.as_mut_slice());
        let matrix = a.transpose() * x + own;
        for (key, ends) in keys.iter().zip(first.windows(2)) {
            // Not a number is no variance either.
            let determined = |i: usize| matrix[(i, i)] * information[i] < MAX_INFLATION;
            if !(ends[0]..ends[1]).all(determined) {
                return Err(undetermined(key));
            }
        }
        Ok(Covariance { keys: keys.to_vec(), first, matrix })
    }
}

/// What covariances are put together from.
struct Parts {
    /// Aᵀ, a column for each direction that was asked for.
    a: DMatrix<f64>,
    /// What is the eliminated variables' own.
    own: DMatrix<f64>,
    /// Of each direction, were all other variables known.
    information: Vec<f64>,
}

impl Parts {
    /// For a reduced system of so many columns, and so many directions.
    fn new(columns: usize, directions: usize) -> Self {
        Self {
            a: DMatrix::zeros(columns, directions),
            own: DMatrix::zeros(directions, directions),
            information: vec![0.0; directions],
        }
    }

    /// The columns of a kept variable, whose directions begin at `at`. `None` when nothing
    /// determines one of them.
    fn add_kept(
        &mut self,
        system: &SchurSystem,
        (store, slot): (usize, usize),
        dof: usize,
        at: usize,
    ) -> Option<()> {
        let place = system.structure.places[store][slot];
        if place.block == NONE {
            return Some(());
        }
        let block = &system.structure.blocks[place.block as usize];
        for (column, i) in block.free_columns().enumerate() {
            let direction =
                i.checked_sub(place.offset as usize).filter(|&direction| direction < dof);
            if let Some(direction) = direction {
                self.a[(block.reduced + column, at + direction)] = 1.0;
                let diagonal = system.reduced.diagonal[block.at + i];
                if diagonal <= 0.0 {
                    return None;
                }
                self.information[at + direction] = diagonal;
            }
        }
        Some(())
    }

    /// A_pᵀ of an eliminated variable, its own (LLᵀ)⁻¹ and the diagonal of its V. `None` when
    /// nothing determines it.
    fn add_eliminated(
        &mut self,
        system: &SchurSystem,
        (store, slot): (usize, usize),
        free: u64,
        at: usize,
    ) -> Option<()> {
        let structure = &system.structure;
        let (chunk, cell) = structure.chunks.iter().find_map(|chunk| {
            let is_it = |cell: &&Cell| {
                cell.dof > 0 && (cell.store as usize, cell.slot as usize) == (store, slot)
            };
            chunk.cells.iter().find(is_it).map(|cell| (chunk, cell))
        })?;
        let p = cell.dof as usize;
        let stash = CellStash::of(&system.memory, cell, chunk);
        let factor = DMatrix::from_fn(p, p, |i, j| if j <= i { stash.factor(i, j) } else { 0.0 });
        let inverse = factor.solve_lower_triangular(&DMatrix::identity(p, p))?;
        // A direction that is held has a one on V's diagonal, for want of anything else, and no
        // variance.
        let moves = |k: usize| free >> k & 1 == 1;
        for k in (0..p).filter(|&k| moves(k)) {
            let diagonal = stash.diagonal(k, 0.0);
            if diagonal <= 0.0 {
                return None;
            }
            self.information[at + k] = diagonal;
        }
        for local in chunk.patterns.locals_of(cell) {
            let touched = chunk.blocks.binary_search_by_key(&local.at, |block| block.1);
            let block = chunk.blocks[touched.expect("a cell's blocks are among its chunk's")].0;
            let block = &structure.blocks[block as usize];
            for (column, i) in block.free_columns().enumerate() {
                for k in 0..p {
                    let sum: f64 = (k..p)
                        .map(|j| inverse[(j, k)] * stash.y.get(p * local.dense + j * local.dof + i))
                        .sum();
                    self.a[(block.reduced + column, at + k)] = -sum;
                }
            }
        }
        let v = inverse.transpose() * inverse;
        for i in (0..p).filter(|&i| moves(i)) {
            for j in (0..p).filter(|&j| moves(j)) {
                self.own[(at + i, at + j)] = v[(i, j)];
            }
        }
        Some(())
    }
}
