//! From a problem to its solution: the choice of a linear solver, and what is found once for many
//! solves.

use std::ops::ControlFlow;

use crate::descent::Descent;
use crate::error::Error;
use crate::options::{LinearSolver, Options};
use crate::problem::Problem;
use crate::qr::QrSystem;
use crate::schur::SchurSystem;
use crate::structure::FACTORS_PER_CHUNK;
use crate::summary::{IterationRecord, Summary};
use crate::system::System;
use crate::variable::{Role, Values};

/// Up to so many numbers in a dense Jacobian, with nothing to eliminate, it is factorised itself
/// rather than squared.
const QR_NUMBERS: usize = 100_000;

/// The structure of a problem — which blocks there are, in which order they are eliminated, who
/// works on what — found once, and the memory to solve it as often as wanted with changing values.
pub struct Solver {
    options: Options,
    system: Box<dyn System>,
    trial: Values,
    revision: u64,
}

impl Solver {
    /// Analyses the problem.
    pub fn new(problem: &Problem, options: &Options) -> Result<Self, Error> {
        options.validate()?;
        let system = || -> Result<Box<dyn System>, Error> {
            Ok(match options.linear_solver {
                LinearSolver::Qr => Box::new(QrSystem::new(problem)?),
                LinearSolver::Auto if prefers_qr(problem) => Box::new(QrSystem::new(problem)?),
                solver => Box::new(SchurSystem::new(problem, solver, options.refinements)?),
            })
        };
        let trial = || problem.values.clone();
        let (system, trial) = if problem.num_factors() > FACTORS_PER_CHUNK {
            rayon::join(system, trial)
        } else {
            (system(), trial())
        };
        Ok(Self { options: options.clone(), system: system?, trial, revision: problem.revision })
    }

    /// Moves the problem's variables downhill. `watch` is called after every attempted step and may
    /// stop the solve.
    pub fn solve(
        &mut self,
        problem: &mut Problem,
        watch: &mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
    ) -> Result<Summary, Error> {
        if problem.revision != self.revision {
            return Err(Error::StructureChanged);
        }
        let Self { options, system, trial, .. } = self;
        let mut descent = Descent::begin(&mut **system, options, problem, trial)?;
        let termination = descent.run(watch);
        Ok(descent.summary(termination))
    }
}

fn prefers_qr(problem: &Problem) -> bool {
    let eliminates =
        problem.metas.iter().flatten().any(|meta| meta.role == Role::Eliminated && meta.free != 0);
    let columns: usize =
        (problem.metas.iter().flatten()).map(|meta| meta.free.count_ones() as usize).sum();
    !eliminates && columns * (problem.num_residuals() + columns) <= QR_NUMBERS
}
