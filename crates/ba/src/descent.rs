//! The Levenberg-Marquardt loop.

use std::ops::ControlFlow;
use std::time::Instant;

use crate::damping::Damping;
use crate::error::Error;
use crate::options::Options;
use crate::problem::Problem;
use crate::summary::{IterationRecord, Summary, Termination, Times};
use crate::system::{Attempt, Linearised, System};
use crate::variable::Values;

/// A step that gains next to nothing ends a solve, unless the linear model promised that many times
/// as much: then it was a bad step, and a shorter one may gain something.
const MIN_GAIN_RATIO: f64 = 0.1;

/// One solve on its way.
pub(crate) struct Descent<'a> {
    system: &'a mut dyn System,
    options: &'a Options,
    problem: &'a mut Problem,
    /// Where a step leads; once it is taken, where it came from.
    trial: &'a mut Values,
    /// The problem at its values.
    now: Linearised,
    initial_cost: f64,
    damping: Damping,
    iterations: Vec<IterationRecord>,
    times: Times,
    begin: Instant,
}

/// What came of a step.
struct Outcome {
    decrease: f64,
    gain_ratio: f64,
    accepted: bool,
}

impl<'a> Descent<'a> {
    /// Linearises at the problem's values.
    pub(crate) fn begin(
        system: &'a mut dyn System,
        options: &'a Options,
        problem: &'a mut Problem,
        trial: &'a mut Values,
    ) -> Result<Self, Error> {
        let begin = Instant::now();
        let mut times = Times::default();
        let damping = Damping::new(options.initial_damping);
        let now = system.linearize(problem, &problem.values, damping.lambda(), &mut times);
        now.check_finite(problem)?;
        let initial_cost = now.cost;
        let iterations = Vec::new();
        Ok(Self {
            system,
            options,
            problem,
            trial,
            now,
            initial_cost,
            damping,
            iterations,
            times,
            begin,
        })
    }

    /// Goes down until nothing is to be gained, or `watch` stops it.
    pub(crate) fn run(
        &mut self,
        watch: &mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
    ) -> Termination {
        loop {
            if let Some(termination) = self.needs_no_step() {
                return termination;
            }
            let lambda = self.damping.lambda();
            let attempt = self.attempt(lambda);
            if attempt.promise <= self.options.step_tolerance.powi(2) * self.now.cost {
                return Termination::StepTolerance;
            }
            let before = self.now;
            let mut outcome = self.judge(&attempt);
            // What comes after the last step of a solve needs no derivatives, unless factors have
            // gone or may have come to exist.
            let others = before.missing + attempt.lost > 0;
            if others {
                outcome.accepted &= self.linearize(outcome.accepted, &before);
            }
            if watch(self.record(&outcome, &before, lambda)).is_break() {
                return Termination::Cancelled;
            }
            if let Some(termination) = self.has_ended(&outcome, &before) {
                return termination;
            }
            if !others
                && !self.linearize(outcome.accepted, &before)
                && let Some(last) = self.iterations.last_mut()
                && last.accepted
            {
                (last.accepted, last.cost) = (false, self.now.cost);
            }
        }
    }

    /// Why there is no point in another step.
    fn needs_no_step(&self) -> Option<Termination> {
        let (num_columns, num_eliminated) = self.system.columns();
        if num_columns + num_eliminated == 0 || self.problem.num_factors() == 0 {
            return Some(Termination::Nothing);
        }
        if self.now.gradient_max <= self.options.gradient_tolerance {
            return Some(Termination::GradientTolerance);
        }
        (self.options.max_iterations == 0).then_some(Termination::MaxIterations)
    }

    /// Where the next step leads. One that cannot be computed leads to infinite cost.
    fn attempt(&mut self, lambda: f64) -> Attempt {
        let values = &self.problem.values;
        let attempt =
            self.system.attempt(self.problem, values, self.trial, lambda, &mut self.times);
        attempt.unwrap_or(Attempt { promise: f64::INFINITY, cost: f64::INFINITY, lost: 0 })
    }

    /// Takes a step that lowers the cost, and changes the damping.
    fn judge(&mut self, attempt: &Attempt) -> Outcome {
        let decrease = self.now.cost - attempt.cost;
        let gain_ratio = decrease / attempt.promise;
        let accepted = decrease > 0.0;
        if accepted {
            std::mem::swap(&mut self.problem.values, self.trial);
            self.damping.accepted(gain_ratio);
            // Exact where the same factors exist before and after.
            (self.now.cost, self.now.missing) = (attempt.cost, self.now.missing + attempt.lost);
        } else if attempt.promise.is_infinite() {
            self.damping.failed();
        } else {
            self.damping.rejected();
        }
        Outcome { decrease, gain_ratio, accepted }
    }

    /// Linearises after a step that was taken or not, from `before`. Gives whether it stays taken:
    /// where the cost is finite but its derivatives are not, the step is as bad as one that raises
    /// the cost.
    fn linearize(&mut self, accepted: bool, before: &Linearised) -> bool {
        let next = self.linearize_here();
        if next.cost.is_finite() && next.gradient_max.is_finite() {
            // `residual` and `linearize` of a factor round differently: compare only what the same
            // one has measured.
            let same = next.missing == before.missing && self.now.missing == before.missing;
            let cost = if same { self.now.cost } else { next.cost };
            self.now = Linearised { cost, ..next };
            return accepted;
        }
        if accepted {
            std::mem::swap(&mut self.problem.values, self.trial);
        }
        self.damping.rejected();
        self.now = Linearised { cost: before.cost, ..self.linearize_here() };
        false
    }

    fn linearize_here(&mut self) -> Linearised {
        let lambda = self.damping.lambda();
        self.system.linearize(self.problem, &self.problem.values, lambda, &mut self.times)
    }

    /// Notes what came of the step from `before`.
    fn record(&mut self, outcome: &Outcome, before: &Linearised, lambda: f64) -> &IterationRecord {
        let record = IterationRecord {
            number: self.iterations.len() + 1,
            cost: self.now.cost,
            decrease: outcome.decrease,
            gain_ratio: outcome.gain_ratio,
            gradient_max: before.gradient_max,
            damping: lambda,
            accepted: outcome.accepted,
            elapsed: self.begin.elapsed(),
        };
        self.iterations.push(record);
        &self.iterations[self.iterations.len() - 1]
    }

    /// Why the step from `before` was the last one.
    fn has_ended(&self, outcome: &Outcome, before: &Linearised) -> Option<Termination> {
        let has_settled = outcome.decrease <= self.options.function_tolerance * before.cost;
        if outcome.accepted && has_settled && outcome.gain_ratio >= MIN_GAIN_RATIO {
            return Some(Termination::FunctionTolerance);
        }
        if self.damping.exhausted() {
            return Some(Termination::NoDescent);
        }
        (self.iterations.len() >= self.options.max_iterations).then_some(Termination::MaxIterations)
    }

    /// What the solve has come to.
    pub(crate) fn summary(mut self, termination: Termination) -> Summary {
        self.times.total = self.begin.elapsed();
        let (num_columns, num_eliminated) = self.system.columns();
        Summary {
            termination,
            initial_cost: self.initial_cost,
            final_cost: self.now.cost,
            iterations: self.iterations,
            missing_factors: self.now.missing,
            num_residuals: self.problem.num_residuals(),
            num_columns,
            num_eliminated,
            linear_solver: self.system.name(),
            times: self.times,
        }
    }
}
