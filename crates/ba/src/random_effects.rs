//! Variables that systematic errors move: the mixed model of statistics.

use nalgebra::{DMatrix, DVector};

/// The normal equations of some variables, the *fixed effects*, and of coefficients with
/// independent normal distributions of zero mean and one variance, the *random effects* (Searle,
/// Casella and McCulloch 1992, chapter 1). All other variables are eliminated.
///
/// Random effects are errors that many factors share, such as the field of displacements that a
/// lens model leaves. Fixed effects that are fitted alone take a part of them.
#[derive(Clone, Debug, PartialEq)]
pub struct RandomEffects {
    /// Differences of the fixed effects from their expected values, in standard deviations of the
    /// expectation.
    pub moved: DVector<f64>,
    /// Information of the fixed effects, then of the random ones: the inverse of their joint
    /// [covariance](crate::Problem::covariance).
    pub information: DMatrix<f64>,
    /// Slopes of the cost at these fixed effects and at random effects of zero.
    pub slopes: DVector<f64>,
}

impl RandomEffects {
    /// Logarithm of the Bayes factor for fixed effects that scatter about their expectations as
    /// these state, against fixed effects that equal them. `None` if fixed effects are
    /// undetermined. The variance of the random effects is [`RandomEffects::variance`].
    pub fn log_bayes_factor(&self, modes: usize) -> Option<f64> {
        let FitWithout { fixed, noise, shifts, information, slopes } = self.fit_without()?;
        let variance = variance_of(information, &slopes, modes);
        let covariance = noise + &shifts * shifts.transpose() * variance;
        let log_likelihood = |scatter: f64| {
            let identity = DMatrix::<f64>::identity(fixed.len(), fixed.len());
            let cholesky = (&covariance + identity * scatter).cholesky()?;
            let log_determinant = 2.0 * cholesky.l_dirty().diagonal().map(f64::ln).sum();
            Some(-0.5 * (fixed.dot(&cholesky.solve(&fixed)) + log_determinant))
        };
        Some(log_likelihood(1.0)? - log_likelihood(0.0)?)
    }

    /// Variance of the random effects: their mean square after a fit of the fixed effects, less the
    /// noise but not below zero, over the `modes` best determined modes. Modes that are hardly
    /// determined show other errors. A mode is an eigenvector of the information. `None` if fixed
    /// effects are undetermined.
    pub fn variance(&self, modes: usize) -> Option<f64> {
        let FitWithout { information, slopes, .. } = self.fit_without()?;
        Some(variance_of(information, &slopes, modes))
    }

    fn fit_without(&self) -> Option<FitWithout> {
        let (p, all) = (self.moved.len(), self.slopes.len());
        let of_fixed = self.information.view((0, 0), (p, p)).clone_owned().cholesky()?;
        let coupling = self.information.view((0, p), (p, all - p)).clone_owned();
        let step = -of_fixed.solve(&self.slopes.rows(0, p).clone_owned());
        let shifts = of_fixed.solve(&coupling);
        let of_random = self.information.view((p, p), (all - p, all - p));
        Some(FitWithout {
            fixed: &self.moved + &step,
            noise: of_fixed.inverse(),
            information: of_random - coupling.transpose() * &shifts,
            slopes: self.slopes.rows(p, all - p) + coupling.transpose() * step,
            shifts,
        })
    }
}

/// A fit of the fixed effects without random ones.
struct FitWithout {
    /// Differences of the fixed effects from their expected values.
    fixed: DVector<f64>,
    /// Their covariance if there are no random effects.
    noise: DMatrix<f64>,
    /// What a unit of each random effect moves them by, up to the sign.
    shifts: DMatrix<f64>,
    /// Information and slopes of the random effects, after the elimination of the fixed ones.
    information: DMatrix<f64>,
    slopes: DVector<f64>,
}

/// [`RandomEffects::variance`] of what is left after the elimination of the fixed effects.
fn variance_of(information: DMatrix<f64>, slopes: &DVector<f64>, modes: usize) -> f64 {
    let eigen = information.symmetric_eigen();
    let slopes = eigen.eigenvectors.transpose() * slopes;
    let mut found: Vec<(f64, f64)> =
        eigen.eigenvalues.iter().copied().zip(slopes.iter().copied()).collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.truncate(modes);
    let square = |&(information, slope): &(f64, f64)| {
        ((slope / information).powi(2) - 1.0 / information).max(0.0)
    };
    found.iter().map(square).sum::<f64>() / found.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::Rng;

    use super::*;

    const FIXED: usize = 3;
    const RANDOM: usize = 12;
    const RESIDUALS: usize = 60;
    const DRAWS: usize = 2_000;
    /// Standard deviation of the random effects; that of the residuals is 1.
    const TAU: f64 = 2.0;
    /// Six standard deviations of the mean square of that many normal numbers.
    const TOLERANCE: f64 = 0.11;

    /// Derivatives of the residuals.
    fn jacobian(rng: &mut Rng) -> DMatrix<f64> {
        DMatrix::from_fn(RESIDUALS, FIXED + RANDOM, |_, _| rng.normal())
    }

    /// Measurements of fixed effects that equal their expectations, linearised elsewhere.
    fn draw(jacobian: &DMatrix<f64>, rng: &mut Rng) -> RandomEffects {
        let random = DVector::from_fn(RANDOM, |_, _| TAU * rng.normal());
        let noise = DVector::from_fn(RESIDUALS, |_, _| rng.normal());
        let moved = DVector::from_fn(FIXED, |_, _| rng.normal());
        let residuals =
            jacobian.columns(0, FIXED) * &moved - jacobian.columns(FIXED, RANDOM) * random + noise;
        let slopes = jacobian.transpose() * residuals;
        RandomEffects { moved, information: jacobian.transpose() * jacobian, slopes }
    }

    #[test]
    fn fixed_effects_scatter_as_their_covariance_says() {
        let mut rng = Rng::stream(1, &[]);
        let jacobian = jacobian(&mut rng);
        let mean_square = (0..DRAWS).map(|_| {
            let fit = draw(&jacobian, &mut rng).fit_without().expect("a regular system");
            let covariance = &fit.noise + &fit.shifts * fit.shifts.transpose() * TAU * TAU;
            let cholesky = covariance.cholesky().expect("a covariance");
            fit.fixed.dot(&cholesky.solve(&fit.fixed))
        });
        let mean_square = mean_square.sum::<f64>() / (DRAWS * FIXED) as f64;
        assert!((mean_square - 1.0).abs() < TOLERANCE, "{mean_square}");
    }

    #[test]
    fn the_variance_of_random_effects_is_found() {
        let mut rng = Rng::stream(2, &[]);
        let jacobian = jacobian(&mut rng);
        let found = (0..DRAWS).map(|_| {
            let fit = draw(&jacobian, &mut rng).fit_without().expect("a regular system");
            variance_of(fit.information, &fit.slopes, RANDOM)
        });
        let ratio = found.sum::<f64>() / DRAWS as f64 / TAU.powi(2);
        assert!((ratio - 1.0).abs() < TOLERANCE, "{ratio}");
    }

    /// Bayes factors above b against a true hypothesis have a probability of 1/b at most (Markov).
    #[test]
    fn bayes_factors_against_the_truth_are_rarely_large() {
        const LARGE: f64 = 10.0;
        let mut rng = Rng::stream(3, &[]);
        let jacobian = jacobian(&mut rng);
        let factors = (0..DRAWS)
            .map(|_| draw(&jacobian, &mut rng).log_bayes_factor(RANDOM).expect("a regular system"));
        let share = factors.filter(|factor| *factor > LARGE.ln()).count() as f64 / DRAWS as f64;
        // The variance is an estimate.
        assert!(share < 1.5 / LARGE, "{share}");
    }

    #[test]
    fn fixed_effects_that_differ_are_found() {
        let mut rng = Rng::stream(4, &[]);
        let jacobian = 10.0 * jacobian(&mut rng);
        for _ in 0..100 {
            let mut system = draw(&jacobian, &mut rng);
            // They equal other values, a hundred standard deviations away.
            system.moved.add_scalar_mut(100.0);
            let factor = system.log_bayes_factor(RANDOM).expect("a regular system");
            assert!(factor > 100.0, "{factor}");
        }
    }
}
