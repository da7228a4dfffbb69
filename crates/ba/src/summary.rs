use std::fmt;
use std::time::Duration;

/// Reason why a solve ended. None of these is an error: the values are always the best ones found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Termination {
    /// The last step lowered the cost by less than
    /// [`Options::function_tolerance`](crate::Options::function_tolerance).
    FunctionTolerance,
    /// The gradient is below [`Options::gradient_tolerance`](crate::Options::gradient_tolerance).
    GradientTolerance,
    /// The next step is below [`Options::step_tolerance`](crate::Options::step_tolerance).
    StepTolerance,
    /// [`Options::max_iterations`](crate::Options::max_iterations) are over.
    MaxIterations,
    /// Not even the shortest step lowers the cost.
    NoDescent,
    /// The callback stopped the solve.
    Cancelled,
    /// Nothing to optimise: no variable, only fixed ones, or no factor.
    Nothing,
}

impl Termination {
    /// Whether the solve converged.
    pub fn converged(self) -> bool {
        matches!(
            self,
            Self::FunctionTolerance | Self::GradientTolerance | Self::StepTolerance | Self::Nothing
        )
    }
}

/// One attempted step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IterationRecord {
    /// Counted from 1.
    pub number: usize,
    /// Cost after the step.
    pub cost: f64,
    /// Decrease of the cost; negative or NaN for a rejected step.
    pub decrease: f64,
    /// The decrease divided by the reduction that the linear model predicted.
    pub gain_ratio: f64,
    /// Largest component of the gradient before the step.
    pub gradient_max: f64,
    /// Damping λ of this step.
    pub damping: f64,
    /// Whether the step was accepted.
    pub accepted: bool,
    /// Time since the start of the solve.
    pub elapsed: Duration,
}

/// Report of a solve.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Reason why it ended.
    pub termination: Termination,
    /// Cost at the initial values.
    pub initial_cost: f64,
    /// Cost at the final values.
    pub final_cost: f64,
    /// All attempted steps.
    pub iterations: Vec<IterationRecord>,
    /// Factors that are invalid at the final values (points behind cameras).
    pub missing_factors: usize,
    /// Number of residuals of all factors.
    pub num_residuals: usize,
    /// Columns of the linear system.
    pub num_columns: usize,
    /// Eliminated columns.
    pub num_eliminated: usize,
    /// Name of the linear solver.
    pub linear_solver: &'static str,
    /// Wall time by part of the work.
    pub times: Times,
}

/// Wall time by part of the work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Times {
    /// Linearisation and elimination.
    pub linearize: Duration,
    /// Summation of the reduced system.
    pub gather: Duration,
    /// Factorisation and solution of the reduced system.
    pub solve: Duration,
    /// Steps of the landmarks.
    pub back_substitute: Duration,
    /// Costs of attempted steps.
    pub evaluate: Duration,
    /// Refinement of the landmarks (see [`Options::refinements`](crate::Options::refinements)).
    pub refine: Duration,
    /// The whole solve.
    pub total: Duration,
}

impl Summary {
    /// Root mean square of the residuals at the final values. Exact for trivial losses only, since
    /// it is computed from the cost.
    pub fn rms_residual(&self) -> f64 {
        (2.0 * self.final_cost / self.num_residuals.max(1) as f64).sqrt()
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "  step          cost      decrease   gain     gradient    damping    time")?;
        for it in &self.iterations {
            writeln!(
                f,
                "{:6} {:13.6e} {:13.3e} {:6.2} {:12.3e} {:10.2e} {:6.1} ms{}",
                it.number,
                it.cost,
                it.decrease,
                it.gain_ratio,
                it.gradient_max,
                it.damping,
                it.elapsed.as_secs_f64() * 1e3,
                if it.accepted { "" } else { "  rejected" },
            )?;
        }
        let missing = match self.missing_factors {
            0 => String::new(),
            n => format!(", {n} factors missing"),
        };
        write!(
            f,
            "{:?} after {} steps: cost {:.6e} -> {:.6e}, {} residuals, {} + {} columns, \
            {}{missing}, {:.1} ms",
            self.termination,
            self.iterations.len(),
            self.initial_cost,
            self.final_cost,
            self.num_residuals,
            self.num_columns,
            self.num_eliminated,
            self.linear_solver,
            self.times.total.as_secs_f64() * 1e3,
        )
    }
}
