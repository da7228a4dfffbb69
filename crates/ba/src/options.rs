use crate::error::Error;

/// How a solve is done. The defaults suit bundle adjustment.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Stop after so many attempted steps.
    pub max_iterations: usize,
    /// Stop when a step lowers the cost by less than this fraction of it, and the linear model did
    /// not promise much more.
    pub function_tolerance: f64,
    /// Stop when no component of the gradient is larger, in units of cost per unit of the variable.
    pub gradient_tolerance: f64,
    /// Stop when the linear model promises to lower the cost by less than the square of this, as a
    /// fraction of the cost: the step then moves the residuals by less than this fraction of their
    /// norm.
    pub step_tolerance: f64,
    /// Damping λ of the first step, relative to the diagonal of JᵀJ.
    pub initial_damping: f64,
    /// After each step, every eliminated variable takes up to so many Gauss-Newton steps of its
    /// own, with the kept ones held, as long as they pay: cheap beside a step of all, of which
    /// fewer are then needed.
    pub refinements: usize,
    /// How the linear system is solved.
    pub linear_solver: LinearSolver,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_iterations: 100,
            function_tolerance: 1e-6,
            gradient_tolerance: 1e-10,
            step_tolerance: 1e-8,
            initial_damping: 1e-4,
            refinements: 3,
            linear_solver: LinearSolver::Auto,
        }
    }
}

/// How the linear system of each step is solved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LinearSolver {
    /// From the structure: [`Qr`](Self::Qr) where nothing is eliminated and the Jacobian is small,
    /// else [`Dense`](Self::Dense) for few kept columns or a full reduced system, else
    /// [`Sparse`](Self::Sparse).
    #[default]
    Auto,
    /// QR factorisation of the whole dense Jacobian, with nothing eliminated: for small
    /// ill-conditioned problems, since it does not square the condition number. Needs memory for
    /// residuals × columns.
    Qr,
    /// Dense Cholesky factorisation of the reduced system.
    Dense,
    /// Sparse supernodal Cholesky factorisation of the reduced system; where its factor does not
    /// fit into 4 GiB, as [`Iterative`](Self::Iterative).
    Sparse,
    /// Conjugate gradients on the reduced system, preconditioned by its diagonal blocks; where it
    /// has more numbers than the observations, as [`Implicit`](Self::Implicit).
    Iterative,
    /// The same without putting the reduced system together: memory grows with the observations
    /// alone.
    Implicit,
}

impl Options {
    /// Checks the ranges.
    pub fn validate(&self) -> Result<(), Error> {
        for (name, value) in [
            ("function_tolerance", self.function_tolerance),
            ("gradient_tolerance", self.gradient_tolerance),
            ("step_tolerance", self.step_tolerance),
        ] {
            if !(0.0..1.0).contains(&value) {
                return Err(Error::Option { name, value, range: "0 ≤ tolerance < 1" });
            }
        }
        if !(self.initial_damping > 0.0 && self.initial_damping.is_finite()) {
            let (name, value) = ("initial_damping", self.initial_damping);
            return Err(Error::Option { name, value, range: "positive and finite" });
        }
        Ok(())
    }
}
