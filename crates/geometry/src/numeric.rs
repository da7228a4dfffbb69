//! Small numerical tools that several crates need: medians, and minima along a line.

/// The upper median of some numbers, which are put in order; `None` of none.
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

/// Where a function with one minimum in [`low`, `high`] has it, by golden section (Kiefer 1953):
/// each step leaves 0.618 of the interval, of which the middle is returned. One evaluation a step,
/// and two before.
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
    let (mut at_a, mut at_b) = (function(a), function(b));
    for _ in 0..steps {
        if at_a <= at_b {
            (high, b, at_b) = (b, a, at_a);
            a = high - RATIO * (high - low);
            at_a = function(a);
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + RATIO * (high - low);
            at_b = function(b);
        }
    }
    0.5 * (low + high)
}
