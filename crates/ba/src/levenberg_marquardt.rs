//! The Levenberg-Marquardt loop.

use std::ops::ControlFlow;
use std::time::Instant;

use crate::damping::Damping;
use crate::error::Error;
use crate::linear_system::{Attempt, LinearSystem, Linearised};
use crate::options::Options;
use crate::problem::Problem;
use crate::summary::{IterationRecord, Summary, Termination, Times};
use crate::variable::Values;

/// A step with next to no decrease ends a solve only from this gain ratio on. Below it, the step
/// was bad, and a shorter one may lower the cost.
const MIN_GAIN_RATIO: f64 = 0.1;

/// State of one solve.
pub(crate) struct LevenbergMarquardt<'a> {
    system: &'a mut dyn LinearSystem,
    options: &'a Options,
    problem: &'a mut Problem,
    /// The values after the attempted step; after an accepted step, the values before it.
    trial: &'a mut Values,
    /// The problem at its current values.
    current: Linearised,
    initial_cost: f64,
    damping: Damping,
    iterations: Vec<IterationRecord>,
    times: Times,
    begin: Instant,
}

/// Outcome of an attempted step.
struct Outcome {
    decrease: f64,
    gain_ratio: f64,
    accepted: bool,
}

impl<'a> LevenbergMarquardt<'a> {
    /// Linearises at the problem's values.
    pub(crate) fn begin(
        system: &'a mut dyn LinearSystem,
        options: &'a Options,
        problem: &'a mut Problem,
        trial: &'a mut Values,
    ) -> Result<Self, Error> {
        let begin = Instant::now();
        let mut times = Times::default();
        let damping = Damping::new(options.initial_damping);
        let current = system.linearize(problem, &problem.values, damping.lambda(), &mut times);
        current.check_finite(problem)?;
        let initial_cost = current.cost;
        let iterations = Vec::new();
        Ok(Self {
            system,
            options,
            problem,
            trial,
            current,
            initial_cost,
            damping,
            iterations,
            times,
            begin,
        })
    }

    /// Iterates until convergence, or until `callback` stops it.
    pub(crate) fn run(
        &mut self,
        callback: &mut dyn FnMut(&IterationRecord) -> ControlFlow<()>,
    ) -> Termination {
        loop {
            if let Some(termination) = self.termination_before_step() {
                return termination;
            }
            let lambda = self.damping.lambda();
            let attempt = self.attempt(lambda);
            if attempt.predicted_reduction
                <= self.options.step_tolerance.powi(2) * self.current.cost
            {
                return Termination::StepTolerance;
            }
            let before = self.current;
            let mut outcome = self.accept_or_reject(&attempt);
            // The last step of a solve needs no derivatives, unless factors were dropped or may
            // have become valid.
            let validity_changed = before.missing + attempt.dropped > 0;
            if validity_changed {
                outcome.accepted &= self.linearize(outcome.accepted, &before);
            }
            if callback(self.record(&outcome, &before, lambda)).is_break() {
                return Termination::Cancelled;
            }
            if let Some(termination) = self.termination_after_step(&outcome, &before) {
                return termination;
            }
            if !validity_changed
                && !self.linearize(outcome.accepted, &before)
                && let Some(last) = self.iterations.last_mut()
                && last.accepted
            {
                (last.accepted, last.cost) = (false, self.current.cost);
            }
        }
    }

    /// Reason to stop before the next step.
    fn termination_before_step(&self) -> Option<Termination> {
        let (num_columns, num_eliminated) = self.system.columns();
        if num_columns + num_eliminated == 0 || self.problem.num_factors() == 0 {
            return Some(Termination::Nothing);
        }
        if self.current.gradient_max <= self.options.gradient_tolerance {
            return Some(Termination::GradientTolerance);
        }
        (self.options.max_iterations == 0).then_some(Termination::MaxIterations)
    }

    /// Solves for the next step. A step that cannot be computed has infinite cost.
    fn attempt(&mut self, lambda: f64) -> Attempt {
        let values = &self.problem.values;
        let attempt =
            self.system.attempt(self.problem, values, self.trial, lambda, &mut self.times);
        attempt.unwrap_or(Attempt {
            predicted_reduction: f64::INFINITY,
            cost: f64::INFINITY,
            dropped: 0,
        })
    }

    /// Accepts a step that lowers the cost, and updates the damping.
    fn accept_or_reject(&mut self, attempt: &Attempt) -> Outcome {
        let decrease = self.current.cost - attempt.cost;
        let gain_ratio = decrease / attempt.predicted_reduction;
        let accepted = decrease > 0.0;
        if accepted {
            std::mem::swap(&mut self.problem.values, self.trial);
            self.damping.accepted(gain_ratio);
            // Exact if the same factors are valid before and after.
            (self.current.cost, self.current.missing) =
                (attempt.cost, self.current.missing + attempt.dropped);
        } else if attempt.predicted_reduction.is_infinite() {
            self.damping.failed();
        } else {
            self.damping.rejected();
        }
        Outcome { decrease, gain_ratio, accepted }
    }

    /// Linearises after an attempted step from `before`. Returns whether the step remains accepted:
    /// a step to a finite cost with non-finite derivatives is rejected.
    fn linearize(&mut self, accepted: bool, before: &Linearised) -> bool {
        let next = self.linearize_here();
        if next.cost.is_finite() && next.gradient_max.is_finite() {
            // `residual` and `linearize` of a factor round differently, so costs are compared only
            // if they come from the same function.
            let same = next.missing == before.missing && self.current.missing == before.missing;
            let cost = if same { self.current.cost } else { next.cost };
            self.current = Linearised { cost, ..next };
            return accepted;
        }
        if accepted {
            std::mem::swap(&mut self.problem.values, self.trial);
        }
        self.damping.rejected();
        self.current = Linearised { cost: before.cost, ..self.linearize_here() };
        false
    }

    fn linearize_here(&mut self) -> Linearised {
        let lambda = self.damping.lambda();
        self.system.linearize(self.problem, &self.problem.values, lambda, &mut self.times)
    }

    /// Records the step from `before`.
    fn record(&mut self, outcome: &Outcome, before: &Linearised, lambda: f64) -> &IterationRecord {
        let record = IterationRecord {
            number: self.iterations.len() + 1,
            cost: self.current.cost,
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

    /// Reason to stop after the step from `before`.
    fn termination_after_step(
        &self,
        outcome: &Outcome,
        before: &Linearised,
    ) -> Option<Termination> {
        let is_small = outcome.decrease <= self.options.function_tolerance * before.cost;
        if outcome.accepted && is_small && outcome.gain_ratio >= MIN_GAIN_RATIO {
            return Some(Termination::FunctionTolerance);
        }
        if self.damping.exhausted() {
            return Some(Termination::NoDescent);
        }
        (self.iterations.len() >= self.options.max_iterations).then_some(Termination::MaxIterations)
    }

    /// The summary of the solve.
    pub(crate) fn summary(mut self, termination: Termination) -> Summary {
        self.times.total = self.begin.elapsed();
        let (num_columns, num_eliminated) = self.system.columns();
        Summary {
            termination,
            initial_cost: self.initial_cost,
            final_cost: self.current.cost,
            iterations: self.iterations,
            missing_factors: self.current.missing,
            num_residuals: self.problem.num_residuals(),
            num_columns,
            num_eliminated,
            linear_solver: self.system.name(),
            times: self.times,
        }
    }
}
