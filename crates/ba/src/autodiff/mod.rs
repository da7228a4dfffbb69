//! Forward-mode automatic differentiation, for factors of which only the residual is written.
//!
//! A dual number a + Σ b_i ε_i with ε_i ε_j = 0 carries the derivatives b of a through any formula
//! (Griewank, Walther 2008, "Evaluating derivatives", chapter 3). Each variable is lifted to x ⊞ ε,
//! which gives derivatives with respect to the tangent. [`DIRECTIONS`] columns of the Jacobian are
//! computed at once.

mod dual;
mod lift;

use nalgebra::SVector;

use crate::factor::{Factor, Linear, Refs, Vars};
pub use dual::{DIRECTIONS, Dual, Scalar};
pub use lift::{Lift, LiftVars, RigidOf};

/// A factor without derivatives. Wrap it in [`AutoDiff`] to add it to a problem.
pub trait Residual<const R: usize>: Send + Sync + 'static {
    /// Types of its variables, as a tuple.
    type Vars: LiftVars;

    /// The residual, for plain and for dual numbers; `None` if it is invalid at these values.
    fn residual<T: Scalar>(&self, x: <Self::Vars as LiftVars>::Of<T>) -> Option<[T; R]>;
}

/// The factor of a [`Residual`], differentiated automatically.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AutoDiff<F>(pub F);

/// Limit on the degrees of freedom of all variables of one factor.
const MAX_COLUMNS: usize = 64;

impl<F: Residual<R>, const R: usize> Factor<R> for AutoDiff<F> {
    type Vars = F::Vars;

    fn linearize(&self, x: Refs<'_, Self::Vars>) -> Option<Linear<Self::Vars, R>> {
        let total = const {
            let total = crate::factor::total_dof(<F::Vars as Vars>::DOFS);
            assert!(total <= MAX_COLUMNS, "too many degrees of freedom in one factor");
            total
        };
        let mut columns = [[0.0; R]; MAX_COLUMNS];
        let mut residual = SVector::zeros();
        for first in (0..total).step_by(DIRECTIONS) {
            let mut tangent = [Dual::from(0.0); MAX_COLUMNS];
            for (i, tangent) in tangent[first..].iter_mut().take(DIRECTIONS).enumerate() {
                tangent.eps[i] = 1.0;
            }
            let lifted = self.0.residual(F::Vars::lift(x, &tangent))?;
            for (r, value) in lifted.iter().enumerate() {
                residual[r] = value.re;
                for (i, column) in columns[first..total].iter_mut().take(DIRECTIONS).enumerate() {
                    column[r] = value.eps[i];
                }
            }
        }
        Some((residual, F::Vars::jacobians(&columns)))
    }

    fn residual(&self, x: Refs<'_, Self::Vars>) -> Option<SVector<f64, R>> {
        self.0.residual(F::Vars::lift(x, &[0.0; MAX_COLUMNS])).map(SVector::from)
    }
}
