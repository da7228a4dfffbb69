//! Covariance of variables: blocks of (JᵀJ)⁻¹ at the current values.
//!
//! The step of an eliminated variable p is δ_p = A_p δ_c with A_p = −L⁻ᵀY (see `eliminate`). With
//! the reduced system S, and A the selection of columns for a kept variable, `cov(a, b) = A_a S⁻¹
//! A_bᵀ`, plus `(LLᵀ)⁻¹` if a and b are the same eliminated variable.

use nalgebra::DMatrix;

use crate::eliminate::LandmarkStash;
use crate::error::Error;
use crate::linear_system::LinearSystem;
use crate::options::LinearSolver;
use crate::problem::Problem;
use crate::reduced::EliminatedSystem;
use crate::schur::SchurSystem;
use crate::structure::{LandmarkBlock, NONE};
use crate::summary::Times;
use crate::undetermined::undetermined_variable;
use crate::variable::{AnyKey, Role};

/// A direction is undetermined if its variance is larger by this factor than its conditional
/// variance given all other variables: the condition number has consumed 13 of the 16 digits of a
/// double.
const MAX_INFLATION: f64 = 1e13;

/// Joint covariance of some variables, in tangent coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Covariance {
    pub(crate) keys: Vec<AnyKey>,
    /// First direction of each, and the number of all.
    pub(crate) first: Vec<usize>,
    pub(crate) matrix: DMatrix<f64>,
}

impl Covariance {
    /// Covariance of one variable: DOF × DOF. `None` if it was not requested.
    pub fn of(&self, key: impl Into<AnyKey>) -> Option<DMatrix<f64>> {
        let key = key.into();
        self.between(key, key)
    }

    /// Cross-covariance of two variables. Rows belong to `a`, columns to `b`.
    pub fn between(&self, a: impl Into<AnyKey>, b: impl Into<AnyKey>) -> Option<DMatrix<f64>> {
        let range = |key: AnyKey| {
            let at = self.keys.iter().position(|other| *other == key)?;
            Some((self.first[at], self.first[at + 1] - self.first[at]))
        };
        let ((row, rows), (column, columns)) = (range(a.into())?, range(b.into())?);
        Some(self.matrix.view((row, column), (rows, columns)).into_owned())
    }

    /// Joint covariance of all requested variables, in the order of the request.
    pub fn matrix(&self) -> &DMatrix<f64> {
        &self.matrix
    }
}

impl Problem {
    /// The covariance of some variables at the current values. Fixed directions have zero rows and
    /// columns. It is that of independent residuals of unit variance;
    /// [`Problem::clustered_covariance`] is that of correlated ones.
    ///
    /// # Errors
    /// [`Error::UnknownVariable`] for a key that the problem does not have, [`Error::Undetermined`]
    /// if the factors do not determine a variable: a requested one, or any that leaves the system
    /// without a solution, which is named; [`Error::NotFinite`] if a factor is not finite,
    /// and the errors of [`Solver::new`](crate::Solver::new) about the structure.
    pub fn covariance(&self, keys: &[AnyKey]) -> Result<Covariance, Error> {
        Ok(InverseColumns::new(self, keys)?.covariance)
    }
}

/// The columns of H⁻¹ = (JᵀJ)⁻¹ that belong to requested directions.
pub(crate) struct InverseColumns {
    pub(crate) system: SchurSystem,
    /// Their rows of kept variables: one row for each column of the reduced system.
    pub(crate) kept: DMatrix<f64>,
    /// Their rows of the requested variables.
    pub(crate) covariance: Covariance,
}

impl InverseColumns {
    pub(crate) fn new(problem: &Problem, keys: &[AnyKey]) -> Result<Self, Error> {
        let mut first = vec![0];
        for key in keys {
            let (store, _) = problem.locate(key)?;
            first.push(first[first.len() - 1] + problem.values.stores[store].dof());
        }
        let mut system = SchurSystem::new(problem, LinearSolver::Auto, 0)?;
        let linearised = system.linearize(problem, &problem.values, 0.0, &mut Times::default());
        linearised.check_finite(problem)?;
        let columns = system.structure.columns;
        let undetermined =
            |key: &AnyKey| Error::Undetermined { variable: key.type_name, slot: key.slot };
        let Some(first_key) = keys.first() else {
            let (kept, matrix) = (DMatrix::zeros(columns, 0), DMatrix::zeros(0, 0));
            return Ok(Self {
                system,
                kept,
                covariance: Covariance { keys: Vec::new(), first, matrix },
            });
        };
        // The whole system has to be solvable, whichever variable is undetermined.
        let eliminated_system =
            EliminatedSystem { structure: &system.structure, memory: &system.memory };
        if system.reduced.factorise(eliminated_system).is_err() {
            let variable = undetermined_variable(problem, &mut system);
            return Err(undetermined(&variable.unwrap_or(*first_key)));
        }
        let mut terms = CovarianceTerms::new(columns, first[keys.len()]);
        for (key, &at) in keys.iter().zip(&first) {
            let (store, slot) = problem.locate(key)?;
            let meta = problem.metas[store][slot];
            let is_determined = if meta.role == Role::Eliminated && meta.free != 0 {
                terms.add_eliminated(&system, (store, slot), meta.free, at)
            } else {
                terms.add_kept(&system, (store, slot), problem.values.stores[store].dof(), at)
            };
            is_determined.ok_or_else(|| undetermined(key))?;
        }
        let CovarianceTerms { a, conditional, information } = terms;
        let mut kept = a.clone();
        system.reduced.solve_columns(eliminated_system, kept.as_mut_slice());
        let matrix = a.transpose() * &kept + conditional;
        for (key, ends) in keys.iter().zip(first.windows(2)) {
            // NaN is not a variance either.
            let determined = |i: usize| matrix[(i, i)] * information[i] < MAX_INFLATION;
            if !(ends[0]..ends[1]).all(determined) {
                return Err(undetermined(key));
            }
        }
        Ok(Self { system, kept, covariance: Covariance { keys: keys.to_vec(), first, matrix } })
    }
}

/// Terms of the covariance.
struct CovarianceTerms {
    /// Aᵀ, one column for each requested direction.
    a: DMatrix<f64>,
    /// (LLᵀ)⁻¹ of eliminated variables: their covariance given the kept variables.
    conditional: DMatrix<f64>,
    /// Information of each direction given all other variables.
    information: Vec<f64>,
}

impl CovarianceTerms {
    /// For a reduced system of `columns` columns and for `directions` requested directions.
    fn new(columns: usize, directions: usize) -> Self {
        Self {
            a: DMatrix::zeros(columns, directions),
            conditional: DMatrix::zeros(directions, directions),
            information: vec![0.0; directions],
        }
    }

    /// Adds the columns of a kept variable, whose directions begin at `at`. `None` if no factor
    /// depends on one of its directions.
    fn add_kept(
        &mut self,
        system: &SchurSystem,
        (store, slot): (usize, usize),
        dof: usize,
        at: usize,
    ) -> Option<()> {
        let location = system.structure.locations[store][slot];
        if location.block == NONE {
            return Some(());
        }
        let block = &system.structure.blocks[location.block as usize];
        for (column, i) in block.free_columns().enumerate() {
            let direction =
                i.checked_sub(location.offset as usize).filter(|&direction| direction < dof);
            if let Some(direction) = direction {
                self.a[(block.first_column + column, at + direction)] = 1.0;
                let diagonal = system.reduced.diagonal[block.padded_start + i];
                if diagonal <= 0.0 {
                    return None;
                }
                self.information[at + direction] = diagonal;
            }
        }
        Some(())
    }

    /// Adds A_pᵀ, (LLᵀ)⁻¹ and the diagonal of V of an eliminated variable. `None` if no factor
    /// depends on one of its directions.
    fn add_eliminated(
        &mut self,
        system: &SchurSystem,
        (store, slot): (usize, usize),
        free: u64,
        at: usize,
    ) -> Option<()> {
        let structure = &system.structure;
        let (task, landmark) = structure.tasks.iter().find_map(|task| {
            let is_it = |landmark: &&LandmarkBlock| {
                landmark.dof > 0
                    && (landmark.store as usize, landmark.slot as usize) == (store, slot)
            };
            task.landmarks.iter().find(is_it).map(|landmark| (task, landmark))
        })?;
        let p = landmark.dof as usize;
        let stash = LandmarkStash::of(&system.memory, landmark, task);
        let factor = DMatrix::from_fn(p, p, |i, j| if j <= i { stash.factor(i, j) } else { 0.0 });
        let inverse = factor.solve_lower_triangular(&DMatrix::identity(p, p))?;
        // A fixed direction has a one on V's diagonal as a placeholder, and no variance.
        let moves = |k: usize| free >> k & 1 == 1;
        for k in (0..p).filter(|&k| moves(k)) {
            let diagonal = stash.diagonal(k, 0.0);
            if diagonal <= 0.0 {
                return None;
            }
            self.information[at + k] = diagonal;
        }
        for pattern_block in task.patterns.blocks_of(landmark) {
            let touched =
                task.blocks.binary_search_by_key(&pattern_block.vector_offset, |block| block.1);
            let block = task.blocks[touched.expect("a landmark's blocks are among its task's")].0;
            let block = &structure.blocks[block as usize];
            for (column, i) in block.free_columns().enumerate() {
                for k in 0..p {
                    let sum: f64 = (k..p)
                        .map(|j| {
                            inverse[(j, k)]
                                * stash.y.get(
                                    p * pattern_block.packed_offset + j * pattern_block.dof + i,
                                )
                        })
                        .sum();
                    self.a[(block.first_column + column, at + k)] = -sum;
                }
            }
        }
        let v = inverse.transpose() * inverse;
        for i in (0..p).filter(|&i| moves(i)) {
            for j in (0..p).filter(|&j| moves(j)) {
                self.conditional[(at + i, at + j)] = v[(i, j)];
            }
        }
        Some(())
    }
}
