//! How much to trust the linear model: Nielsen's rule (Madsen, Nielsen, Tingleff 2004, "Methods for
//! non-linear least squares problems", algorithm 3.16), which is also that of Ceres' trust region,
//! but bolder where the model was right. With the rule as it is, a gain ratio of 0.8 step after
//! step, as in the valleys of bundle adjustment, hardly lowers λ: Ladybug-49 takes 32 steps instead
//! of some 20.

/// From these gain ratios on, best first, λ falls by these factors.
const BOLD: [(f64, f64); 2] = [(0.9, 0.1), (0.7, MAX_DECREASE)];
/// The factor by which λ falls after a step at its best, in Nielsen's rule.
const MAX_DECREASE: f64 = 1.0 / 3.0;
/// λ stays within these: below, it is lost in rounding; above, no step that could matter remains.
const RANGE: (f64, f64) = (1e-16, 1e32);

#[derive(Clone, Copy, Debug)]
pub(crate) struct Damping {
    lambda: f64,
    increase: f64,
    least: f64,
}

impl Damping {
    pub(crate) fn new(lambda: f64) -> Self {
        Self { lambda, increase: 2.0, least: RANGE.0 }
    }

    pub(crate) fn lambda(&self) -> f64 {
        self.lambda
    }

    /// After a step that lowered the cost by `gain_ratio` times what the model promised.
    pub(crate) fn accepted(&mut self, gain_ratio: f64) {
        let bold = BOLD.iter().find(|(from, _)| gain_ratio >= *from).map(|(_, factor)| *factor);
        let factor =
            bold.unwrap_or_else(|| (1.0 - (2.0 * gain_ratio - 1.0).powi(3)).max(MAX_DECREASE));
        self.lambda = (self.lambda * factor).max(self.least);
        self.increase = 2.0;
    }

    /// Where the system could not be solved: so little damping is not tried again.
    pub(crate) fn failed(&mut self) {
        self.rejected();
        self.least = self.least.max(self.lambda);
    }

    /// After a step that did not lower the cost.
    pub(crate) fn rejected(&mut self) {
        self.lambda *= self.increase;
        self.increase *= 2.0;
    }

    /// Whether there is no point in shorter steps.
    pub(crate) fn exhausted(&self) -> bool {
        self.lambda > RANGE.1
    }
}

/// λD of a direction with this entry on the diagonal of JᵀJ: Marquardt's scaling, which makes the
/// step independent of units. A direction that no factor sees gets a one for now, and stays where
/// it is.
#[inline(always)]
pub(crate) fn marquardt(diagonal: f64, lambda: f64) -> f64 {
    if diagonal > 0.0 { lambda * diagonal } else { 1.0 }
}
