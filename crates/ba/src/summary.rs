use std::fmt;
use std::time::Duration;

/// Why a solve ended. None of these is an error: the values are always the best that were found.
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
    /// The callback said so.
    Cancelled,
    /// There is nothing to move: no variable, all of them fixed, or no factor.
    Nothing,
}

impl Termination {
    /// Whether the solve ended because it was done.
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
    /// From 1.
    pub number: usize,
    /// The cost after it.
    pub cost: f64,
    /// By how much it lowered the cost; negative or NaN when it was rejected.
    pub decrease: f64,
    /// The decrease divided by what the linear model promised.
    pub gain_ratio: f64,
    /// Largest component of the gradient before it.
    pub gradient_max: f64,
    /// Damping λ of this step.
    pub damping: f64,
    /// Whether it was taken.
    pub accepted: bool,
    /// Time since the solve began.
    pub elapsed: Duration,
}

/// What a solve did.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Why it ended.
    pub termination: Termination,
    /// Cost at the beginning.
    pub initial_cost: f64,
    /// Cost at the end.
    pub final_cost: f64,
    /// Every attempted step.
    pub iterations: Vec<IterationRecord>,
    /// Factors that do not exist at the final values (points behind cameras).
    pub missing_factors: usize,
    /// Residuals of all factors.
    pub num_residuals: usize,
    /// Columns of the linear system that was solved.
    pub num_columns: usize,
    /// Columns that were eliminated before.
    pub num_eliminated: usize,
    /// Name of the linear solver.
    pub linear_solver: &'static str,
    /// Where the time went.
    pub times: Times,
}

/// Wall time by part of the work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Times {
    /// Linearisation and elimination.
    pub linearize: Duration,
    /// Putting the reduced system together.
    pub gather: Duration,
    /// Factorising and solving it.
    pub solve: Duration,
    /// Steps of the eliminated variables.
    pub back_substitute: Duration,
    /// Costs of attempted steps.
    pub evaluate: Duration,
    /// Steps of the eliminated variables on their own.
    pub refine: Duration,
    /// All of the solve.
    pub total: Duration,
}

impl Summary {
    /// Root mean square of the residuals at the end, were all losses trivial.
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
