//! The poses of a camera over time, and where it was in between.

use tiepoint_geometry::Rigid3;

use crate::Knots;

/// Nothing is interpolated across gaps longer than so many usual intervals.
const MAX_GAP: f64 = 2.5;
/// Images nearer to each other than this share of the usual interval were not taken one after the other.
const MIN_GAP: f64 = 0.05;

/// The poses of a camera (`cam_from_world`) in order of time.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    times_s: Vec<f64>,
    poses: Vec<Rigid3>,
    interval_s: f64,
}

impl Trajectory {
    /// From samples in order of time.
    pub fn new(samples: impl IntoIterator<Item = (f64, Rigid3)>) -> Self {
        let (times_s, poses): (Vec<f64>, Vec<Rigid3>) = samples.into_iter().unzip();
        let interval_s = interval_s(&times_s);
        Self { times_s, poses, interval_s }
    }

    /// Median time between two samples; infinite for fewer than two.
    pub fn interval_s(&self) -> f64 {
        self.interval_s
    }

    /// When the samples are.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// The first of four consecutive samples around a time: two before and two after it, at the ends one and three. `None` outside,
    /// and where samples are missing.
    pub fn knots_around(&self, time_s: f64) -> Option<usize> {
        let count = self.times_s.len();
        let is_inside = count >= 4 && self.times_s[0] <= time_s && time_s <= self.times_s[count - 1];
        if !is_inside {
            return None;
        }
        let after = self.times_s.partition_point(|other| *other <= time_s);
        let first = after.saturating_sub(2).min(count - 4);
        let is_usual = |gap: f64| (MIN_GAP * self.interval_s..=MAX_GAP * self.interval_s).contains(&gap);
        self.times_s[first..first + 4].windows(2).all(|pair| is_usual(pair[1] - pair[0])).then_some(first)
    }

    /// Four consecutive samples.
    pub fn knots(&self, first: usize) -> Knots<'_> {
        Knots {
            poses: std::array::from_fn(|k| &self.poses[first + k]),
            times_s: std::array::from_fn(|k| self.times_s[first + k]),
        }
    }

    /// The pose at a time.
    pub fn at(&self, time_s: f64) -> Option<Rigid3> {
        Some(self.knots(self.knots_around(time_s)?).at(time_s))
    }
}

/// Median of the differences of times in order.
pub fn interval_s(times_s: &[f64]) -> f64 {
    let mut intervals: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    intervals.sort_by(f64::total_cmp);
    intervals.get(intervals.len() / 2).copied().unwrap_or(f64::INFINITY)
}
