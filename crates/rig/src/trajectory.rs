//! The poses of a camera over time, where it was in between, and how far that can be trusted.

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::numeric::median;

use crate::{Knots, scaled_motion};

/// Nothing is interpolated across gaps longer than so many usual intervals.
const MAX_GAP: f64 = 2.5;
/// Images nearer to each other than this share of the usual interval were not taken one after the
/// other.
const MIN_GAP: f64 = 0.05;

/// How much of what a sample is off from the cubic through its four neighbours an interpolated pose
/// is off in the middle between two samples: 0.14 of it where the motion is smooth (f⁗h⁴ · 0.56
/// against 4), 0.9 where samples know nothing of each other. Four samples around are asked, since
/// motion that shakes goes another way each time.
const PERTURBATION: f64 = 0.5;

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

    /// The first of four consecutive samples around a time: two before and two after it, at the
    /// ends one and three. `None` outside, and where samples are missing.
    pub fn knots_around(&self, time_s: f64) -> Option<usize> {
        let count = self.times_s.len();
        let is_inside =
            count >= 4 && self.times_s[0] <= time_s && time_s <= self.times_s[count - 1];
        if !is_inside {
            return None;
        }
        let after = self.times_s.partition_point(|other| *other <= time_s);
        let first = after.saturating_sub(2).min(count - 4);
        let is_usual =
            |gap: f64| (MIN_GAP * self.interval_s..=MAX_GAP * self.interval_s).contains(&gap);
        self.times_s[first..first + 4]
            .windows(2)
            .all(|pair| is_usual(pair[1] - pair[0]))
            .then_some(first)
    }

    /// Four consecutive samples.
    pub fn knots(&self, first: usize) -> Knots<'_> {
        Knots {
            poses: std::array::from_fn(|k| &self.poses[first + k]),
            times_s: std::array::from_fn(|k| self.times_s[first + k]),
        }
    }

    /// Motions by which the pose at a time may be off, one standard deviation each: what the camera
    /// does in `time_sigma_s`, and what the four samples around it are off from the cubic through
    /// their neighbours, as far as the time is away from samples.
    pub fn pose_perturbations(&self, first: usize, time_s: f64, time_sigma_s: f64) -> [Rigid3; 5] {
        let knots = self.knots(first);
        let back = knots.at(time_s).inverse();
        let blur = knots.at(time_s + time_sigma_s) * back;
        let h = self.interval_s;
        let in_the_middle = 0.5625 * h.powi(4);
        let share: f64 =
            knots.times_s.iter().map(|t| time_s - t).product::<f64>().abs() / in_the_middle;
        let [a, b, c, d] =
            std::array::from_fn(|k| self.leave_one_out_residual(first + k, PERTURBATION * share));
        [Some(blur), a, b, c, d].map(|motion| motion.unwrap_or_else(Rigid3::identity))
    }

    /// What a sample, or the nearest one with two neighbours on either side, is off from the cubic
    /// through its neighbours: `share` of it.
    fn leave_one_out_residual(&self, index: usize, share: f64) -> Option<Rigid3> {
        let index = index.clamp(2, self.times_s.len().checked_sub(3).filter(|last| *last >= 2)?);
        let around = [index - 2, index - 1, index + 1, index + 2];
        let knots = Knots {
            poses: around.map(|k| &self.poses[k]),
            times_s: around.map(|k| self.times_s[k]),
        };
        let motion = knots.at(self.times_s[index]) * self.poses[index].inverse();
        Some(scaled_motion(&motion, share))
    }

    /// The pose at a time.
    pub fn at(&self, time_s: f64) -> Option<Rigid3> {
        Some(self.knots(self.knots_around(time_s)?).at(time_s))
    }
}

/// How much times that should be evenly spaced are off, from the median of their second
/// differences: a standard deviation in seconds.
pub fn timestamp_jitter_s(times_s: &[f64]) -> f64 {
    // Of |x| for a unit normal; the second difference has six times the variance.
    const MEDIAN: f64 = 0.6745;
    let mut seconds: Vec<f64> =
        times_s.windows(3).map(|t| (t[0] - 2.0 * t[1] + t[2]).abs()).collect();
    median(&mut seconds).map_or(0.0, |median| median / (MEDIAN * 6f64.sqrt()))
}

/// Median of the differences of times in order.
pub fn interval_s(times_s: &[f64]) -> f64 {
    let mut intervals: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    median(&mut intervals).unwrap_or(f64::INFINITY)
}
