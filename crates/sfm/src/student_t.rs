//! Student's t of paired differences.

/// Mean of the differences in its standard deviations; 0 with fewer than two, which have none.
pub(crate) fn student_t(differences: &[f64]) -> f64 {
    let count = differences.len() as f64;
    if differences.len() < 2 {
        return 0.0;
    }
    let mean = differences.iter().sum::<f64>() / count;
    let variance = differences.iter().map(|it| (it - mean).powi(2)).sum::<f64>() / (count - 1.0);
    mean / (variance / count).sqrt().max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::student_t;

    #[test]
    fn values_are_those_of_the_formula() {
        // Mean 2, variance 1: 2 / (1 / √3).
        assert!((student_t(&[1.0, 2.0, 3.0]) - 12f64.sqrt()).abs() < 1e-12);
        assert_eq!(student_t(&[-1.0, 1.0]), 0.0);
        assert!(student_t(&[0.5; 4]) > 1e9, "no deviation");
        assert_eq!([student_t(&[]), student_t(&[1.0]), student_t(&[0.0; 4])], [0.0; 3]);
    }
}
