//! Choice of the linear solver, and reuse of the symbolic structure between solves.

use std::ops::ControlFlow;

use crate::error::Error;
use crate::levenberg_marquardt::LevenbergMarquardt;
use crate::linear_system::LinearSystem;
use crate::options::{LinearSolver, Options};
use crate::problem::Problem;
use crate::qr::QrSystem;
use crate::schur::SchurSystem;
use crate::structure::FACTORS_PER_TASK;
use crate::summary::{IterationRecord, Summary};
use crate::variable::{Role, Values};

/// A problem without landmarks is solved by QR if its normal and Jacobian matrices have at most
/// this many elements together.
const QR_NUMBERS: usize = 100_000;

/// The symbolic structure of a problem (blocks, elimination order, parallel tasks) and the memory
/// to solve it repeatedly with changing values.
pub struct Solver {
    options: Options,
    system: Box<dyn LinearSystem>,
    trial: Values,
    revision: u64,
}

impl Solver {
    /// Analyses the structure of the problem.
    ///
    /// # Errors
    /// [`Error::Option`] for an option out of range, [`Error::TwoEliminated`] if a factor joins two
    /// landmarks, [`Error::TooLarge`] for more factors or variables than can be numbered.
    pub fn new(problem: &Problem, options: &Options) -> Result<Self, Error> {
        options.validate()?;
        let system = || -> Result<Box<dyn LinearSystem>, Error> {
            Ok(match options.linear_solver {
                LinearSolver::Qr => Box::new(QrSystem::new(problem)?),
                LinearSolver::Auto if prefers_qr(problem) => Box::new(QrSystem::new(problem)?),
                solver => Box::new(SchurSystem::new(problem, solver, options.refinements)?),
            })
        };
        let trial = || problem.values.clone();
        let (system, trial) = if problem.num_factors() > FACTORS_PER_TASK {
            rayon::join(system, trial)
        } else {
            (system(), trial())
        };
        Ok(Self { options: options.clone(), system: system?, trial, revision: problem.revision })
    }

    /// Minimises the cost over the problem's variables.
    ///
    /// # Errors
    /// [`Error::StructureChanged`] if variables, factors or fixed directions have changed since
    /// [`Solver::new`]; [`Error::NotFinite`] if a factor is not finite at the initial values.
    pub fn solve(&mut self, problem: &mut Problem) -> Result<Summary, Error> {
        self.solve_with(problem, &mut |_| ControlFlow::Continue(()))
    }

    /// [`Solver::solve`] with a callback that is called after every attempted step and may stop the
    /// solve.
    ///
    /// # Errors
    /// As there.
    pub fn solve_with(
        &mut self,
        problem: &mut Problem,
        callback: &mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
    ) -> Result<Summary, Error> {
        if problem.revision != self.revision {
            return Err(Error::StructureChanged);
        }
        let Self { options, system, trial, .. } = self;
        let mut minimizer = LevenbergMarquardt::begin(&mut **system, options, problem, trial)?;
        let termination = minimizer.run(callback);
        Ok(minimizer.summary(termination))
    }
}

fn prefers_qr(problem: &Problem) -> bool {
    let eliminates =
        problem.metas.iter().flatten().any(|meta| meta.role == Role::Eliminated && meta.free != 0);
    let columns: usize =
        (problem.metas.iter().flatten()).map(|meta| meta.free.count_ones() as usize).sum();
    !eliminates && columns * (problem.num_residuals() + columns) <= QR_NUMBERS
}
