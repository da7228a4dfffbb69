//! Dense Levenberg-Marquardt for a few parameters, without heap allocation: the local refinement
//! of robust estimation (Madsen, Nielsen, Tingleff 2004, "Methods for non-linear least squares
//! problems", algorithm 3.16, with Nielsen's damping). `tiepoint-ba` adjusts reconstructions.

use nalgebra::{SMatrix, SVector};

use crate::Loss;

/// Maximum number of iterations of a local refinement.
pub(crate) const MAX_LM_ITERATIONS: usize = 25;

/// A least-squares problem over `N` local parameters.
pub(crate) trait Problem<const N: usize> {
    /// The estimate.
    type Value: Clone;
    /// The value perturbed by a tangent vector.
    fn plus(&self, value: &Self::Value, delta: &SVector<f64, N>) -> Self::Value;
    /// Adds every residual and its Jacobian to the normal equations.
    fn linearize(&self, value: &Self::Value, normal: &mut NormalEquations<N>);
}

/// Normal equations: JᵀJ (upper triangle), Jᵀr and the cost, half the sum of ρ(|r|²).
pub(crate) struct NormalEquations<const N: usize> {
    hessian: SMatrix<f64, N, N>,
    gradient: SVector<f64, N>,
    cost: f64,
    loss: Loss,
}

impl<const N: usize> NormalEquations<N> {
    pub(crate) fn new(loss: Loss) -> Self {
        Self { hessian: SMatrix::zeros(), gradient: SVector::zeros(), cost: 0.0, loss }
    }

    /// Adds one residual of `R` components.
    #[inline]
    pub(crate) fn add<const R: usize>(
        &mut self,
        residual: &SVector<f64, R>,
        jacobian: &SMatrix<f64, R, N>,
    ) {
        let [rho, weight, _] = self.loss.evaluate(residual.norm_squared());
        self.cost += 0.5 * rho;
        for column in 0..N {
            let weighted = jacobian.column(column) * weight;
            self.gradient[column] += weighted.dot(residual);
            for row in 0..=column {
                self.hessian[(row, column)] += weighted.dot(&jacobian.column(row));
            }
        }
    }

    /// The loss that weights the residuals.
    pub(crate) fn loss(&self) -> Loss {
        self.loss
    }

    /// Adds JᵀJ and Jᵀr of many residuals, weighted by the loss, and half the sum of their ρ.
    pub(crate) fn add_sums(
        &mut self,
        hessian: &SMatrix<f64, N, N>,
        gradient: &SVector<f64, N>,
        cost: f64,
    ) {
        self.hessian += hessian;
        self.gradient += gradient;
        self.cost += cost;
    }

    /// The largest relative difference of the cost, of the gradient and of the upper triangle of
    /// JᵀJ.
    #[cfg(test)]
    pub(crate) fn relative_difference(&self, other: &Self) -> f64 {
        let cost = (self.cost - other.cost).abs() / other.cost;
        let gradient = (self.gradient - other.gradient).norm() / other.gradient.norm();
        let upper = |normal: &Self| normal.hessian.upper_triangle();
        let hessian = (upper(self) - upper(other)).norm() / upper(other).norm();
        cost.max(gradient).max(hessian)
    }

    /// Whether a residual was undefined.
    #[cfg(test)]
    pub(crate) fn is_rejected(&self) -> bool {
        self.cost == f64::INFINITY
    }

    /// The model cost change of a step under the undamped quadratic model, as a decrease.
    fn predicted_decrease(&self, step: &SVector<f64, N>) -> f64 {
        let hessian =
            SMatrix::from_fn(|row, column| self.hessian[(row.min(column), row.max(column))]);
        -step.dot(&(self.gradient + hessian * step * 0.5))
    }

    /// Marks that a residual is undefined at this value. [`minimize`] then rejects the step.
    pub(crate) fn reject(&mut self) {
        self.cost = f64::INFINITY;
    }
}

/// Initial damping, relative to the diagonal of JᵀJ. It is small because the initial values are
/// near the optimum.
const INITIAL_DAMPING: f64 = 1e-4;

/// Convergence: the relative decrease of the cost is at most this.
const COST_TOLERANCE: f64 = 1e-7;

/// Added to the diagonal of JᵀJ, relative to its largest entry. It keeps the matrix regular if a
/// parameter has no influence on the residuals.
const DIAGONAL_FLOOR: f64 = 1e-12;

/// Minimises the cost from `start`. Returns `start` itself if no step reduces the cost.
pub(crate) fn minimize<const N: usize, P: Problem<N>>(
    problem: &P,
    start: &P::Value,
    loss: Loss,
    max_iterations: usize,
) -> P::Value {
    let linearize = |value: &P::Value| {
        let mut normal = NormalEquations::new(loss);
        problem.linearize(value, &mut normal);
        normal
    };
    let mut value = start.clone();
    let mut normal = linearize(&value);
    let (mut damping, mut growth) = (INITIAL_DAMPING, 2.0);
    for _ in 0..max_iterations {
        let Some(step) = damped_step(&normal, damping) else {
            damping *= growth;
            growth *= 2.0;
            continue;
        };
        let candidate = problem.plus(&value, &step);
        let candidate_normal = linearize(&candidate);
        if candidate_normal.cost < normal.cost {
            let decrease = normal.cost - candidate_normal.cost;
            let converged = decrease <= COST_TOLERANCE * normal.cost;
            let gain = decrease / normal.predicted_decrease(&step);
            damping *= (1.0 - (2.0 * gain - 1.0).powi(3)).clamp(1.0 / 3.0, 2.0);
            growth = 2.0;
            (value, normal) = (candidate, candidate_normal);
            if converged {
                break;
            }
        } else {
            // At the minimum the cost changes by rounding only: stop if the rejected step had no
            // predicted decrease.
            if normal.predicted_decrease(&step) <= COST_TOLERANCE * normal.cost {
                break;
            }
            damping *= growth;
            growth *= 2.0;
        }
    }
    value
}

/// The minimiser of the damped quadratic model; `None` if its matrix is not numerically positive
/// definite.
fn damped_step<const N: usize>(
    normal: &NormalEquations<N>,
    damping: f64,
) -> Option<SVector<f64, N>> {
    let floor = DIAGONAL_FLOOR * normal.hessian.diagonal().max();
    let mut lower = normal.hessian.transpose();
    for i in 0..N {
        lower[(i, i)] += damping * lower[(i, i)] + floor;
    }
    // Cholesky, in place in the lower triangle.
    for j in 0..N {
        for k in 0..j {
            let factor = lower[(j, k)];
            for i in j..N {
                lower[(i, j)] -= factor * lower[(i, k)];
            }
        }
        let pivot = lower[(j, j)];
        if !(pivot.is_finite() && pivot > 0.0) {
            return None;
        }
        let inverse = 1.0 / pivot.sqrt();
        for i in j..N {
            lower[(i, j)] *= inverse;
        }
    }
    let mut x = -normal.gradient;
    for i in 0..N {
        for j in 0..i {
            x[i] -= lower[(i, j)] * x[j];
        }
        x[i] /= lower[(i, i)];
    }
    for i in (0..N).rev() {
        for j in i + 1..N {
            x[i] -= lower[(j, i)] * x[j];
        }
        x[i] /= lower[(i, i)];
    }
    x.iter().all(|v| v.is_finite()).then_some(x)
}
