//! What the Levenberg-Marquardt loop asks of a linear solver.

use crate::error::Error;
use crate::problem::Problem;
use crate::summary::Times;
use crate::variable::Values;

/// The problem at the values it was linearised at.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Linearised {
    pub(crate) cost: f64,
    /// Factors that do not exist.
    pub(crate) missing: usize,
    /// Largest component of the gradient; not finite when some number in the system is not.
    pub(crate) gradient_max: f64,
}

impl Linearised {
    /// Which factor is to blame where a number is not finite.
    pub(crate) fn check_finite(&self, problem: &Problem) -> Result<(), Error> {
        if self.cost.is_finite() && self.gradient_max.is_finite() {
            return Ok(());
        }
        for run in &problem.runs {
            if let Some((index, what, value)) = run.find_not_finite(&problem.values) {
                return Err(Error::NotFinite { factor: run.factor_type(), index, what, value });
            }
        }
        // Every number and its square are finite, yet their sum is not.
        let factor = problem.runs.first().map_or("", |run| run.factor_type());
        Err(Error::NotFinite { factor, index: 0, what: "sum of squares", value: self.cost })
    }
}

pub(crate) trait System: Send {
    fn name(&self) -> &'static str;
    /// Columns of the linear system, and those eliminated before.
    fn columns(&self) -> (usize, usize);
    /// Linearises at `values`. (λ is needed where elimination is part of it.)
    fn linearize(
        &mut self,
        problem: &Problem,
        values: &Values,
        lambda: f64,
        times: &mut Times,
    ) -> Linearised;
    /// Solves for the step from `values`, writes where it leads to `trial`, and evaluates the cost
    /// there of the factors that existed where the system was linearised. May shorten the steps of
    /// single eliminated variables to keep their factors alive, and let go of factors that live no
    /// longer even where those stand still. `None` when the system cannot be solved with this
    /// damping.
    fn attempt(
        &mut self,
        problem: &Problem,
        values: &Values,
        trial: &mut Values,
        lambda: f64,
        times: &mut Times,
    ) -> Option<Attempt>;
}

/// Where a step leads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Attempt {
    /// By how much the linear model says the cost falls.
    pub(crate) promise: f64,
    /// Infinite where a factor is not finite, or does not exist that did and was not let go.
    pub(crate) cost: f64,
    /// Factors that exist no longer and count with the cost that they had.
    pub(crate) lost: usize,
}
