//! Trajectories: poses in order of time. How much they drift over given stretches (RPE; Sturm et
//! al. 2012, Geiger et al. 2012), and which pose belongs to which when two clocks tick.

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;

/// Error of the motion between two poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionError {
    /// Length of the wrong translation, in units of the truth.
    pub translation: f64,
    /// Angle of the wrong rotation.
    pub rotation_rad: f64,
}

/// Every pose with the one `step` frames later.
pub fn pairs_by_frames(count: usize, step: usize) -> Vec<(usize, usize)> {
    (step..count).map(|end| (end - step, end)).collect()
}

/// Every pose with the first one that is at least `length` further along the path, as in the KITTI
/// odometry benchmark.
pub fn pairs_by_path(centres: &[Vector3<f64>], length: f64) -> Vec<(usize, usize)> {
    let travelled = travelled(centres);
    let end_of = |start: usize| {
        let end = travelled.partition_point(|way| *way < travelled[start] + length).max(start);
        (end < centres.len()).then_some((start, end))
    };
    (0..centres.len()).filter_map(end_of).collect()
}

/// The path in consecutive stretches of at least `length`, as in evo.
pub fn consecutive_pairs_by_path(centres: &[Vector3<f64>], length: f64) -> Vec<(usize, usize)> {
    let (mut pairs, mut start, mut way) = (Vec::new(), 0, 0.0);
    for (index, step) in centres.windows(2).enumerate() {
        way += (step[1] - step[0]).norm();
        if way >= length {
            pairs.push((start, index + 1));
            (start, way) = (index + 1, 0.0);
        }
    }
    pairs
}

/// The length of the path up to each centre.
fn travelled(centres: &[Vector3<f64>]) -> Vec<f64> {
    let mut way = 0.0;
    let steps = centres.windows(2).map(|step| (step[1] - step[0]).norm());
    std::iter::once(0.0)
        .chain(steps)
        .map(|step| {
            way += step;
            way
        })
        .collect()
}

/// The error of the motion from the first to the second pose of each pair: what is left of the true
/// motion after the model's has been undone. Poses are `cam_from_world`, and the model's scale is
/// the true one: see [`crate::PoseComparison::truth_from_model`] and `Sim3::transform_pose` where
/// it is not.
pub fn relative_motion_errors(
    model: &[Rigid3],
    truth: &[Rigid3],
    pairs: &[(usize, usize)],
) -> Vec<MotionError> {
    let motion =
        |poses: &[Rigid3], (start, end): (usize, usize)| poses[start] * poses[end].inverse();
    let error = |pair: &(usize, usize)| {
        let wrong = motion(truth, *pair).inverse() * motion(model, *pair);
        MotionError { translation: wrong.translation.norm(), rotation_rad: wrong.rotation.angle() }
    };
    pairs.iter().map(error).collect()
}

/// For each time of the shorter list the nearest of the other, where it is at most
/// `max_difference_s` away: pairs of indices into `a_s` and `b_s`. Both are sorted.
pub fn associate(a_s: &[f64], b_s: &[f64], max_difference_s: f64) -> Vec<(usize, usize)> {
    if a_s.len() > b_s.len() {
        return associate(b_s, a_s, max_difference_s).into_iter().map(|(b, a)| (a, b)).collect();
    }
    let nearest = |(index, time): (usize, &f64)| {
        let after = b_s.partition_point(|other| other < time);
        let candidates = after.saturating_sub(1)..(after + 1).min(b_s.len());
        let distance = |other: &usize| (b_s[*other] - time).abs();
        let best = candidates.min_by(|x, y| distance(x).total_cmp(&distance(y)))?;
        (distance(&best) <= max_difference_s).then_some((index, best))
    };
    a_s.iter().enumerate().filter_map(nearest).collect()
}
