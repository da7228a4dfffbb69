//! Damping of Levenberg-Marquardt: Nielsen's rule (Madsen, Nielsen, Tingleff 2004, "Methods for
//! non-linear least squares problems", algorithm 3.16), which Ceres' trust region uses as well,
//! with a faster decrease after steps that the linear model predicted well. With the plain rule, a
//! gain ratio of 0.8 step after step, which is common in bundle adjustment, hardly lowers λ:
//! Ladybug-49 takes 32 steps instead of about 20.

/// Gain ratios from which on λ is multiplied by these factors, the largest first.
const FAST_DECREASE: [(f64, f64); 2] = [(0.9, 0.1), (0.7, MAX_DECREASE)];
/// Smallest factor of λ in Nielsen's rule.
const MAX_DECREASE: f64 = 1.0 / 3.0;
/// Range of λ: below it, λ is lost in rounding; above it, steps are too short to matter.
const LAMBDA_RANGE: (f64, f64) = (1e-16, 1e32);

#[derive(Clone, Copy, Debug)]
pub(crate) struct Damping {
    lambda: f64,
    increase: f64,
    min_lambda: f64,
}

impl Damping {
    pub(crate) fn new(lambda: f64) -> Self {
        Self { lambda, increase: 2.0, min_lambda: LAMBDA_RANGE.0 }
    }

    pub(crate) fn lambda(&self) -> f64 {
        self.lambda
    }

    /// After a step that lowered the cost by `gain_ratio` times the predicted reduction.
    pub(crate) fn accepted(&mut self, gain_ratio: f64) {
        let fast =
            FAST_DECREASE.iter().find(|(from, _)| gain_ratio >= *from).map(|(_, factor)| *factor);
        let factor =
            fast.unwrap_or_else(|| (1.0 - (2.0 * gain_ratio - 1.0).powi(3)).max(MAX_DECREASE));
        self.lambda = (self.lambda * factor).max(self.min_lambda);
        self.increase = 2.0;
    }

    /// After a failed factorisation: λ never becomes as small again.
    pub(crate) fn failed(&mut self) {
        self.rejected();
        self.min_lambda = self.min_lambda.max(self.lambda);
    }

    /// After a step that did not lower the cost.
    pub(crate) fn rejected(&mut self) {
        self.lambda *= self.increase;
        self.increase *= 2.0;
    }

    /// Whether shorter steps are pointless.
    pub(crate) fn exhausted(&self) -> bool {
        self.lambda > LAMBDA_RANGE.1
    }
}

/// λD of a direction, given its element of the diagonal of JᵀJ: Marquardt's scaling, which makes
/// the step independent of units. A direction that no factor depends on gets a one, and does not
/// move.
#[inline(always)]
pub(crate) fn marquardt(diagonal: f64, lambda: f64) -> f64 {
    if diagonal > 0.0 { lambda * diagonal } else { 1.0 }
}
