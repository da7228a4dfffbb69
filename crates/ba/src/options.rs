use crate::error::Error;

/// Options of a solve. The defaults suit bundle adjustment.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Maximal number of attempted steps.
    pub max_iterations: usize,
    /// Stop when a step lowers the cost by less than this fraction of it, and the linear model did
    /// not predict much more.
    pub function_tolerance: f64,
    /// Stop when no component of the gradient is larger, in units of cost per unit of the variable.
    pub gradient_tolerance: f64,
    /// Stop when the linear model predicts a decrease of less than the square of this, as a
    /// fraction of the cost: the step then changes the residuals by less than this fraction of
    /// their norm.
    pub step_tolerance: f64,
    /// Damping λ of the first step, relative to the diagonal of JᵀJ.
    pub initial_damping: f64,
    /// Maximal number of Gauss-Newton steps that every landmark takes by itself after each step,
    /// with the kept variables constant. They are cheap, and fewer steps of the whole problem are
    /// needed.
    pub refinements: usize,
    /// Linear solver.
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

/// Linear solver of each step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LinearSolver {
    /// Chosen by the structure: [`Qr`](Self::Qr) if nothing is eliminated and the Jacobian is
    /// small, else [`Dense`](Self::Dense) for few kept columns or a full reduced system, else
    /// [`Sparse`](Self::Sparse).
    #[default]
    Auto,
    /// QR factorisation of the whole dense Jacobian, without elimination: for small ill-conditioned
    /// problems, because it does not square the condition number. Needs memory for residuals ×
    /// columns.
    Qr,
    /// Dense Cholesky factorisation of the reduced system.
    Dense,
    /// Sparse supernodal Cholesky factorisation of the reduced system, or
    /// [`Iterative`](Self::Iterative) if its factor does not fit into 4 GiB.
    Sparse,
    /// Conjugate gradients on the reduced system, preconditioned by its diagonal blocks, or
    /// [`Implicit`](Self::Implicit) if the reduced system has more elements than Y.
    Iterative,
    /// Conjugate gradients without forming the reduced system: memory is proportional to the
    /// observations.
    Implicit,
}

impl Options {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`Error::Option`] names the first option that is out of range.
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
