//! How long what a mounting leaves goes on from moment to moment.

use tiepoint_geometry::nalgebra::Vector3;

/// By how much the variance of the mean of what is left is larger than if moments were independent:
/// the integrated autocorrelation time, summed for as long as the autocorrelation is positive
/// (after Geyer 1992, section 3.3). `left` is in standard deviations of each component; where it is
/// far within them it is the images' noise that the mounting takes away, and no property of the
/// mount.
pub(super) fn autocorrelation_time(left: &[Vector3<f64>]) -> f64 {
    let together = |lag: usize| left.iter().zip(&left[lag..]).map(|(a, b)| a.dot(b)).sum::<f64>();
    let all = together(0);
    if all <= 0.0 {
        return 1.0;
    }
    let shares = (1..left.len()).map(|lag| together(lag) / all).take_while(|share| *share > 0.0);
    let goes_on = 2.0 * shares.sum::<f64>();
    let of_deviation = (all / (3 * left.len()) as f64).min(1.0);
    1.0 + goes_on * of_deviation
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_geometry::Rng;

    const MOMENTS: usize = 4000;
    /// Of a time that is estimated from so many moments: the lags that are summed by accident.
    const TOLERANCE: f64 = 0.25;

    fn noise(rng: &mut Rng) -> Vector3<f64> {
        Vector3::new(rng.normal(), rng.normal(), rng.normal())
    }

    #[test]
    fn independent_moments_count_fully() {
        let mut rng = Rng::stream(1, &[]);
        let left: Vec<_> = (0..MOMENTS).map(|_| noise(&mut rng)).collect();
        assert!(
            (autocorrelation_time(&left) - 1.0).abs() < TOLERANCE,
            "{}",
            autocorrelation_time(&left)
        );
    }

    /// Of x' = a x + √(1 - a²) noise the integrated autocorrelation time is (1 + a)/(1 - a).
    #[test]
    fn what_goes_on_is_told() {
        const A: f64 = 0.8;
        let mut rng = Rng::stream(2, &[]);
        let mut x = noise(&mut rng);
        let left: Vec<_> = (0..MOMENTS)
            .map(|_| {
                x = x * A + noise(&mut rng) * (1.0 - A * A).sqrt();
                x
            })
            .collect();
        let expected = (1.0 + A) / (1.0 - A);
        assert!(
            (autocorrelation_time(&left) / expected - 1.0).abs() < TOLERANCE,
            "{}",
            autocorrelation_time(&left)
        );
        // What is far within the deviations says nothing of the mount.
        let little: Vec<_> = left.iter().map(|x| x * 0.1).collect();
        assert!(
            (autocorrelation_time(&little) - 1.0).abs() < TOLERANCE,
            "{}",
            autocorrelation_time(&little)
        );
    }

    #[test]
    fn nothing_left_is_fine() {
        assert_eq!(autocorrelation_time(&[]), 1.0);
        assert_eq!(autocorrelation_time(&[Vector3::zeros(); 3]), 1.0);
    }
}
