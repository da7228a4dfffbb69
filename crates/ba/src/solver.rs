//! The Levenberg-Marquardt loop.

use std::ops::ControlFlow;
use std::time::Instant;

use crate::damping::Damping;
use crate::error::Error;
use crate::options::{LinearSolver, Options};
use crate::problem::Problem;
use crate::qr::QrSystem;
use crate::schur::SchurSystem;
use crate::structure::FACTORS_PER_CHUNK;
use crate::summary::{IterationRecord, Summary, Termination, Times};
use crate::system::{Attempt, Linearised, System};
use crate::variable::{Role, Values};

/// Up to so many numbers in a dense Jacobian, with nothing to eliminate, it is factorised itself rather than squared.
const QR_NUMBERS: usize = 100_000;

/// A step that gains next to nothing ends a solve, unless the linear model promised that many times as much: then it was a bad step,
/// and a shorter one may gain something.
const MIN_GAIN_RATIO: f64 = 0.1;

/// The structure of a problem — which blocks there are, in which order they are eliminated, who works on what — found once,
/// and the memory to solve it as often as wanted with changing values.
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

    /// Moves the problem's variables downhill. `watch` is called after every attempted step and may stop the solve.
    pub fn solve(
        &mut self,
        problem: &mut Problem,
        watch: &mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
    ) -> Result<Summary, Error> {
        if problem.revision != self.revision {
            return Err(Error::StructureChanged);
        }
        let begin = Instant::now();
        let (num_columns, num_eliminated) = self.system.columns();
        let mut times = Times::default();
        let mut damping = Damping::new(self.options.initial_damping);
        let mut now = self.system.linearize(problem, &problem.values, damping.lambda(), &mut times);
        check_finite(problem, &now)?;
        let initial_cost = now.cost;
        let mut iterations: Vec<IterationRecord> = Vec::new();
        let termination = loop {
            if num_columns + num_eliminated == 0 || problem.num_factors() == 0 {
                break Termination::Nothing;
            }
            if now.gradient_max <= self.options.gradient_tolerance {
                break Termination::GradientTolerance;
            }
            if self.options.max_iterations == 0 {
                break Termination::MaxIterations;
            }
            let lambda = damping.lambda();
            // A step that cannot be computed leads to infinite cost.
            let attempt = self.system.attempt(problem, &problem.values, &mut self.trial, lambda, &mut times);
            let attempt = attempt.unwrap_or(Attempt { promise: f64::INFINITY, cost: f64::INFINITY, lost: 0 });
            if attempt.promise <= self.options.step_tolerance.powi(2) * now.cost {
                break Termination::StepTolerance;
            }
            let decrease = now.cost - attempt.cost;
            let gain_ratio = decrease / attempt.promise;
            let mut accepted = decrease > 0.0;
            let before = now;
            if accepted {
                std::mem::swap(&mut problem.values, &mut self.trial);
                damping.accepted(gain_ratio);
                // Exact where the same factors exist before and after.
                (now.cost, now.missing) = (attempt.cost, before.missing + attempt.lost);
            } else if attempt.promise.is_infinite() {
                damping.failed();
            } else {
                damping.rejected();
            }
            // What comes after the last step of a solve needs no derivatives, unless factors have gone or may have come to exist.
            let others = before.missing + attempt.lost > 0;
            if others {
                accepted &= self.linearize(problem, accepted, &mut now, &before, &mut damping, &mut times);
            }
            iterations.push(IterationRecord {
                number: iterations.len() + 1,
                cost: now.cost,
                decrease,
                gain_ratio,
                gradient_max: before.gradient_max,
                damping: lambda,
                accepted,
                elapsed: begin.elapsed(),
            });
            if iterations.last().is_some_and(|record| watch(record).is_break()) {
                break Termination::Cancelled;
            }
            let has_settled = decrease <= self.options.function_tolerance * before.cost;
            if accepted && has_settled && gain_ratio >= MIN_GAIN_RATIO {
                break Termination::FunctionTolerance;
            }
            if damping.exhausted() {
                break Termination::NoDescent;
            }
            if iterations.len() >= self.options.max_iterations {
                break Termination::MaxIterations;
            }
            if !others
                && !self.linearize(problem, accepted, &mut now, &before, &mut damping, &mut times)
                && let Some(last) = iterations.last_mut()
                && last.accepted
            {
                (last.accepted, last.cost) = (false, now.cost);
            }
        };
        times.total = begin.elapsed();
        Ok(Summary {
            termination,
            initial_cost,
            final_cost: now.cost,
            iterations,
            missing_factors: now.missing,
            num_residuals: problem.num_residuals(),
            num_columns,
            num_eliminated,
            linear_solver: self.system.name(),
            times,
        })
    }

    /// Linearises after a step that was taken or not, from `before`. Gives whether it stays taken: where the cost is finite but
    /// its derivatives are not, the step is as bad as one that raises the cost.
    fn linearize(
        &mut self,
        problem: &mut Problem,
        accepted: bool,
        now: &mut Linearised,
        before: &Linearised,
        damping: &mut Damping,
        times: &mut Times,
    ) -> bool {
        let next = self.system.linearize(problem, &problem.values, damping.lambda(), times);
        if next.cost.is_finite() && next.gradient_max.is_finite() {
            // `residual` and `linearize` of a factor round differently: compare only what the same one has measured.
            let same = next.missing == before.missing && now.missing == before.missing;
            let cost = if same { now.cost } else { next.cost };
            *now = Linearised { cost, ..next };
            return accepted;
        }
        if accepted {
            std::mem::swap(&mut problem.values, &mut self.trial);
        }
        damping.rejected();
        let again = self.system.linearize(problem, &problem.values, damping.lambda(), times);
        *now = Linearised { cost: before.cost, ..again };
        false
    }
}

pub(crate) fn check_finite(problem: &Problem, at: &Linearised) -> Result<(), Error> {
    if at.cost.is_finite() && at.gradient_max.is_finite() {
        return Ok(());
    }
    for run in &problem.runs {
        if let Some((index, what, value)) = run.find_not_finite(&problem.values) {
            return Err(Error::NotFinite { factor: run.factor_type(), index, what, value });
        }
    }
    // Every number and its square are finite, yet their sum is not.
    let factor = problem.runs.first().map_or("", |run| run.factor_type());
    Err(Error::NotFinite { factor, index: 0, what: "sum of squares", value: at.cost })
}

fn prefers_qr(problem: &Problem) -> bool {
    let eliminates =
        problem.metas.iter().flatten().any(|meta| meta.role == Role::Eliminated && meta.free != 0);
    let columns: usize = (problem.metas.iter().flatten()).map(|meta| meta.free.count_ones() as usize).sum();
    !eliminates && columns * (problem.num_residuals() + columns) <= QR_NUMBERS
}
