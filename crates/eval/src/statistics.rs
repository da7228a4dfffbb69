/// Statistics of a list of errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Statistics {
    /// Number of errors.
    pub count: usize,
    /// Mean.
    pub mean: f64,
    /// Median; the mean of the middle two for an even number.
    pub median: f64,
    /// Root mean square.
    pub rmse: f64,
    /// Standard deviation with division by n.
    pub std: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

impl Statistics {
    /// Computes the statistics; `None` for an empty list.
    pub fn of(errors: &[f64]) -> Option<Self> {
        let mut sorted = errors.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (count, min, max) = (sorted.len(), *sorted.first()?, *sorted.last()?);
        let mean_of = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / count as f64;
        let mean = mean_of(&mut errors.iter().copied());
        let square = mean_of(&mut errors.iter().map(|error| error * error));
        let variance = mean_of(&mut errors.iter().map(|error| (error - mean).powi(2)));
        let median = 0.5 * (sorted[(count - 1) / 2] + sorted[count / 2]);
        Some(Self { count, mean, median, rmse: square.sqrt(), std: variance.sqrt(), min, max })
    }
}
