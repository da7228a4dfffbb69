//! Interface between the Levenberg-Marquardt loop and the linear solvers.

use crate::error::Error;
use crate::problem::Problem;
use crate::summary::Times;
use crate::variable::Values;

/// Cost and gradient at the linearisation point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Linearised {
    pub(crate) cost: f64,
    /// Number of invalid factors.
    pub(crate) missing: usize,
    /// Largest component of the gradient; not finite if any number in the system is not.
    pub(crate) gradient_max: f64,
}

impl Linearised {
    /// Finds the factor that is not finite.
    pub(crate) fn check_finite(&self, problem: &Problem) -> Result<(), Error> {
        if self.cost.is_finite() && self.gradient_max.is_finite() {
            return Ok(());
        }
        for group in &problem.factor_groups {
            if let Some((index, what, value)) = group.find_not_finite(&problem.values) {
                return Err(Error::NotFinite { factor: group.factor_type(), index, what, value });
            }
        }
        // Every number and its square are finite, but their sum is not.
        let factor = problem.factor_groups.first().map_or("", |group| group.factor_type());
        Err(Error::NotFinite { factor, index: 0, what: "sum of squares", value: self.cost })
    }
}

pub(crate) trait LinearSystem: Send {
    fn name(&self) -> &'static str;
    /// Columns of the linear system, and eliminated columns.
    fn columns(&self) -> (usize, usize);
    /// Linearises at `values`. Elimination needs λ already.
    fn linearize(
        &mut self,
        problem: &Problem,
        values: &Values,
        lambda: f64,
        times: &mut Times,
    ) -> Linearised;
    /// Solves for the step from `values`, writes the resulting values to `trial`, and evaluates the
    /// cost there of the factors that were valid at the linearisation. May shorten the steps of
    /// single landmarks to keep their factors valid, and drop factors that are invalid even if
    /// their landmark does not move. `None` if the system cannot be solved with this damping.
    fn attempt(
        &mut self,
        problem: &Problem,
        values: &Values,
        trial: &mut Values,
        lambda: f64,
        times: &mut Times,
    ) -> Option<Attempt>;
}

/// Result of a step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Attempt {
    /// Decrease of the cost that the linear model predicts (model cost change).
    pub(crate) predicted_reduction: f64,
    /// Infinite if a factor is not finite, or became invalid and was not dropped.
    pub(crate) cost: f64,
    /// Number of factors that became invalid and count with their cost before the step.
    pub(crate) dropped: usize,
}
