/// What a list of errors comes to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Statistics {
    /// How many.
    pub count: usize,
    /// Mean.
    pub mean: f64,
    /// Median; the mean of the middle two of an even number.
    pub median: f64,
    /// Root of the mean square.
    pub rmse: f64,
    /// Standard deviation from the mean, of the list itself (division by n).
    pub std: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

impl Statistics {
    /// Of a list; `None` of an empty one.
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
