//! Autocorrelation of the residuals of a rig constraint over time.

use tiepoint_geometry::nalgebra::Vector3;

/// Integrated autocorrelation time: the ratio of the variance of the mean to that of independent
/// residuals. The sum ends at the first autocorrelation that is not positive (after Geyer 1992,
/// section 3.3). `residuals` are whitened. Residuals far below one standard deviation come from
/// image noise and not from the mount, so the sum is scaled by their mean square if that is below
/// one.
pub(super) fn autocorrelation_time(residuals: &[Vector3<f64>]) -> f64 {
    let autocovariance =
        |lag: usize| residuals.iter().zip(&residuals[lag..]).map(|(a, b)| a.dot(b)).sum::<f64>();
    let variance = autocovariance(0);
    if variance <= 0.0 {
        return 1.0;
    }
    let correlations = (1..residuals.len())
        .map(|lag| autocovariance(lag) / variance)
        .take_while(|correlation| *correlation > 0.0);
    let twice_sum = 2.0 * correlations.sum::<f64>();
    let mean_square = (variance / (3 * residuals.len()) as f64).min(1.0);
    1.0 + twice_sum * mean_square
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_geometry::Rng;

    const NUM_SAMPLES: usize = 4000;
    /// Relative error of a time estimated from [`NUM_SAMPLES`] residuals.
    const TOLERANCE: f64 = 0.25;

    fn noise(rng: &mut Rng) -> Vector3<f64> {
        Vector3::new(rng.normal(), rng.normal(), rng.normal())
    }

    #[test]
    fn independent_residuals_have_time_one() {
        let mut rng = Rng::stream(1, &[]);
        let residuals: Vec<_> = (0..NUM_SAMPLES).map(|_| noise(&mut rng)).collect();
        assert!(
            (autocorrelation_time(&residuals) - 1.0).abs() < TOLERANCE,
            "{}",
            autocorrelation_time(&residuals)
        );
    }

    /// The process x' = a x + √(1 - a²) noise has the autocorrelation time (1 + a)/(1 - a).
    #[test]
    fn what_twice_sum_is_told() {
        const A: f64 = 0.8;
        let mut rng = Rng::stream(2, &[]);
        let mut x = noise(&mut rng);
        let residuals: Vec<_> = (0..NUM_SAMPLES)
            .map(|_| {
                x = x * A + noise(&mut rng) * (1.0 - A * A).sqrt();
                x
            })
            .collect();
        let expected = (1.0 + A) / (1.0 - A);
        assert!(
            (autocorrelation_time(&residuals) / expected - 1.0).abs() < TOLERANCE,
            "{}",
            autocorrelation_time(&residuals)
        );
        // Residuals far below one standard deviation count as independent.
        let small: Vec<_> = residuals.iter().map(|x| x * 0.1).collect();
        assert!(
            (autocorrelation_time(&small) - 1.0).abs() < TOLERANCE,
            "{}",
            autocorrelation_time(&small)
        );
    }

    #[test]
    fn zero_residuals_have_time_one() {
        assert_eq!(autocorrelation_time(&[]), 1.0);
        assert_eq!(autocorrelation_time(&[Vector3::zeros(); 3]), 1.0);
    }
}
