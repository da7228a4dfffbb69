//! Robust losses ρ(s) of the squared residual norm s = |r|², for RANSAC and bundle adjustment.
//!
//! Every loss has ρ(0) = 0, ρ'(0) = 1 and 0 ≤ ρ' ≤ 1: it is the squared norm near zero and grows
//! more slowly for large residuals. The parameter `a` is the scale in the unit of the residual: the
//! residual norm at which the loss departs from the squared norm (Ceres, `loss_function.h`;
//! Barron 2019 for Geman-McClure).

use crate::OptionError;

/// A robust loss with its scale.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Loss {
    /// ρ = s.
    #[default]
    Trivial,
    /// ρ = s up to a², then 2a√s − a².
    Huber(f64),
    /// ρ = 2a² (√(1 + s/a²) − 1).
    SoftL1(f64),
    /// ρ = a² ln(1 + s/a²).
    Cauchy(f64),
    /// ρ = a² s / (a² + s).
    GemanMcClure(f64),
    /// Tukey's biweight: ρ = a²/3 (1 − (1 − s/a²)³) up to a², then a²/3.
    Tukey(f64),
    /// ρ = min(s, a²): the score of MSAC.
    Truncated(f64),
}

impl Loss {
    /// Checks the scale.
    ///
    /// # Errors
    ///
    /// The scale is not finite and above 0.
    pub fn validate(&self) -> Result<(), OptionError> {
        match *self {
            Loss::Trivial => Ok(()),
            Loss::Huber(a)
            | Loss::SoftL1(a)
            | Loss::Cauchy(a)
            | Loss::GemanMcClure(a)
            | Loss::Tukey(a)
            | Loss::Truncated(a) => OptionError::check_positive("loss scale", a),
        }
    }

    /// ρ(s), ρ'(s), ρ''(s) of a squared norm s ≥ 0.
    #[inline]
    pub fn evaluate(&self, s: f64) -> [f64; 3] {
        match *self {
            Loss::Trivial => [s, 1.0, 0.0],
            Loss::Huber(a) => {
                if s <= a * a {
                    [s, 1.0, 0.0]
                } else {
                    let r = s.sqrt();
                    let d1 = a / r;
                    [2.0 * a * r - a * a, d1, -0.5 * d1 / s]
                }
            }
            Loss::SoftL1(a) => {
                let b = a * a;
                let root = (1.0 + s / b).sqrt();
                let d1 = 1.0 / root;
                [2.0 * b * (root - 1.0), d1, -0.5 * d1 / (b * root * root)]
            }
            Loss::Cauchy(a) => {
                let b = a * a;
                let d1 = b / (b + s);
                [b * (s / b).ln_1p(), d1, -d1 * d1 / b]
            }
            Loss::GemanMcClure(a) => {
                let b = a * a;
                let ratio = b / (b + s);
                [ratio * s, ratio * ratio, -2.0 * ratio * ratio / (b + s)]
            }
            Loss::Tukey(a) => {
                let b = a * a;
                if s < b {
                    let v = 1.0 - s / b;
                    [b / 3.0 * (1.0 - v * v * v), v * v, -2.0 * v / b]
                } else {
                    [b / 3.0, 0.0, 0.0]
                }
            }
            Loss::Truncated(a) => {
                if s < a * a {
                    [s, 1.0, 0.0]
                } else {
                    [a * a, 0.0, 0.0]
                }
            }
        }
    }
}
