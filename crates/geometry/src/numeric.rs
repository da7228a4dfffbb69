//! Numerical functions that several crates share: median and golden-section search.

/// Median norm of a vector of two standard normal variables: the root of 2 ln 2.
pub const MEDIAN_NORM_OF_TWO: f64 = 1.177;

/// The upper median of the values, or `None` if there are none. Sorts the values.
///
/// ```
/// use tiepoint_geometry::numeric::median;
///
/// assert_eq!(median(&mut [3.0, 1.0, 2.0]), Some(2.0));
/// assert_eq!(median(&mut [4.0, 1.0, 2.0, 3.0]), Some(3.0));
/// assert_eq!(median(&mut []), None);
/// ```
pub fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// The minimiser of a unimodal function on [`low`, `high`], by golden-section search (Kiefer 1953).
///
/// Each step reduces the interval to 0.618 of its length. The result is the middle of the last
/// interval. The function is evaluated `steps + 2` times.
///
/// ```
/// use tiepoint_geometry::numeric::golden_section;
///
/// let least = golden_section(|x| (x - 0.3) * (x - 0.3), -1.0, 1.0, 30);
/// assert!((least - 0.3).abs() < 1e-6);
/// ```
pub fn golden_section(
    function: impl Fn(f64) -> f64,
    mut low: f64,
    mut high: f64,
    steps: usize,
) -> f64 {
    const RATIO: f64 = 0.618_033_988_749_895;
    let (mut a, mut b) = (high - RATIO * (high - low), low + RATIO * (high - low));
    let (mut value_a, mut value_b) = (function(a), function(b));
    for _ in 0..steps {
        if value_a <= value_b {
            (high, b, value_b) = (b, a, value_a);
            a = high - RATIO * (high - low);
            value_a = function(a);
        } else {
            (low, a, value_a) = (a, b, value_b);
            b = low + RATIO * (high - low);
            value_b = function(b);
        }
    }
    0.5 * (low + high)
}
