//! The trajectory of a camera: interpolation between its images, and the covariance of interpolated
//! poses.

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::numeric::median;

use crate::{Knots, scaled_motion};

/// Gaps longer than this many median intervals are not interpolated.
const MAX_INTERVAL_RATIO: f64 = 2.5;
/// Images that are closer than this fraction of the median interval were not taken one after the
/// other.
const MIN_INTERVAL_RATIO: f64 = 0.05;

/// Standard deviation of an interpolated pose half way between two samples, as a fraction of the
/// leave-one-out residual: the error of a sample with respect to the cubic through its four
/// neighbours. The exact fraction is 0.14 for smooth motion (f⁗h⁴ · 0.56 against 4) and 0.9 for
/// independent samples. The residuals of the four surrounding samples are all used, because
/// vibration has a different direction at each.
const PERTURBATION_PER_RESIDUAL: f64 = 0.5;

/// The poses of a camera (`cam_from_world`) at ascending times.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    times_s: Vec<f64>,
    poses: Vec<Rigid3>,
    interval_s: f64,
}

impl Trajectory {
    /// From pairs of time in seconds and pose, at ascending times.
    pub fn new(samples: impl IntoIterator<Item = (f64, Rigid3)>) -> Self {
        let (times_s, poses): (Vec<f64>, Vec<Rigid3>) = samples.into_iter().unzip();
        let interval_s = interval_s(&times_s);
        Self { times_s, poses, interval_s }
    }

    /// Median time between two samples in seconds; infinite for fewer than two.
    pub fn interval_s(&self) -> f64 {
        self.interval_s
    }

    /// Times of the samples in seconds.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// Index of the first of the four consecutive samples around a time: two before and two after
    /// it, one and three at the ends. `None` outside the trajectory, and if samples are missing.
    pub fn knots_around(&self, time_s: f64) -> Option<usize> {
        let count = self.times_s.len();
        let is_inside =
            count >= 4 && self.times_s[0] <= time_s && time_s <= self.times_s[count - 1];
        if !is_inside {
            return None;
        }
        let after = self.times_s.partition_point(|other| *other <= time_s);
        let first = after.saturating_sub(2).min(count - 4);
        let is_usual = |gap: f64| {
            (MIN_INTERVAL_RATIO * self.interval_s..=MAX_INTERVAL_RATIO * self.interval_s)
                .contains(&gap)
        };
        self.times_s[first..first + 4]
            .windows(2)
            .all(|pair| is_usual(pair[1] - pair[0]))
            .then_some(first)
    }

    /// The four consecutive samples from `first` on.
    pub fn knots(&self, first: usize) -> Knots<'_> {
        Knots {
            poses: std::array::from_fn(|k| &self.poses[first + k]),
            times_s: std::array::from_fn(|k| self.times_s[first + k]),
        }
    }

    /// Covariance of the interpolated pose at a time, as pose perturbations (motions) of one
    /// standard deviation each. The first one is the motion during `time_sigma_s`. The other four
    /// are fractions of the leave-one-out residuals of the four surrounding samples; the fraction
    /// grows with the distance from the samples.
    pub fn pose_perturbations(&self, first: usize, time_s: f64, time_sigma_s: f64) -> [Rigid3; 5] {
        let knots = self.knots(first);
        let world_from_cam = knots.at(time_s).inverse();
        let motion_in_sigma = knots.at(time_s + time_sigma_s) * world_from_cam;
        let h = self.interval_s;
        let in_the_middle = 0.5625 * h.powi(4);
        let fraction: f64 =
            knots.times_s.iter().map(|t| time_s - t).product::<f64>().abs() / in_the_middle;
        let [a, b, c, d] = std::array::from_fn(|k| {
            self.leave_one_out_residual(first + k, PERTURBATION_PER_RESIDUAL * fraction)
        });
        [Some(motion_in_sigma), a, b, c, d].map(|motion| motion.unwrap_or_else(Rigid3::identity))
    }

    /// Leave-one-out residual, times `fraction`: the motion from a sample to the cubic through its
    /// neighbours. For the first and last two samples, that of the nearest sample with two
    /// neighbours on either side. `None` for fewer than five samples.
    fn leave_one_out_residual(&self, index: usize, fraction: f64) -> Option<Rigid3> {
        let index = index.clamp(2, self.times_s.len().checked_sub(3).filter(|last| *last >= 2)?);
        let neighbours = [index - 2, index - 1, index + 1, index + 2];
        let knots = Knots {
            poses: neighbours.map(|k| &self.poses[k]),
            times_s: neighbours.map(|k| self.times_s[k]),
        };
        let motion = knots.at(self.times_s[index]) * self.poses[index].inverse();
        Some(scaled_motion(&motion, fraction))
    }

    /// The interpolated pose at a time; `None` outside the trajectory, and if samples are missing.
    pub fn at(&self, time_s: f64) -> Option<Rigid3> {
        Some(self.knots(self.knots_around(time_s)?).at(time_s))
    }
}

/// Standard deviation in seconds of timestamps that should be evenly spaced, from the median of
/// their second differences.
pub fn timestamp_jitter_s(times_s: &[f64]) -> f64 {
    // Median of |x| for a unit normal. The second difference has six times the variance.
    const MEDIAN: f64 = 0.6745;
    let mut seconds: Vec<f64> =
        times_s.windows(3).map(|t| (t[0] - 2.0 * t[1] + t[2]).abs()).collect();
    median(&mut seconds).map_or(0.0, |median| median / (MEDIAN * 6f64.sqrt()))
}

/// Median difference of ascending times in seconds; infinite for fewer than two.
pub fn interval_s(times_s: &[f64]) -> f64 {
    let mut intervals: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    median(&mut intervals).unwrap_or(f64::INFINITY)
}
