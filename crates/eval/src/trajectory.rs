//! Relative pose error (RPE) of trajectories (Sturm et al. 2012, Geiger et al. 2012), and
//! association of two trajectories by time.

use tiepoint_geometry::Rigid3;
use tiepoint_geometry::nalgebra::Vector3;

/// Error of the relative motion between two poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionError {
    /// Length of the translation error, in units of the ground truth.
    pub translation: f64,
    /// Angle of the rotation error.
    pub rotation_rad: f64,
}

/// Index pairs of every pose with the one `step` frames later.
pub fn pairs_by_frames(count: usize, step: usize) -> Vec<(usize, usize)> {
    (step..count).map(|end| (end - step, end)).collect()
}

/// Index pairs of every pose with the first one that is at least `length` further along the path,
/// as in the KITTI odometry benchmark.
pub fn pairs_by_path(centres: &[Vector3<f64>], length: f64) -> Vec<(usize, usize)> {
    let path = path_lengths(centres);
    let end_of = |start: usize| {
        let end = path.partition_point(|to| *to < path[start] + length).max(start);
        (end < centres.len()).then_some((start, end))
    };
    (0..centres.len()).filter_map(end_of).collect()
}

/// Index pairs of consecutive path segments of at least `length`, as in evo.
pub fn consecutive_pairs_by_path(centres: &[Vector3<f64>], length: f64) -> Vec<(usize, usize)> {
    let (mut pairs, mut start, mut segment) = (Vec::new(), 0, 0.0);
    for (index, step) in centres.windows(2).enumerate() {
        segment += (step[1] - step[0]).norm();
        if segment >= length {
            pairs.push((start, index + 1));
            (start, segment) = (index + 1, 0.0);
        }
    }
    pairs
}

/// Length of the path from the first centre to each centre.
fn path_lengths(centres: &[Vector3<f64>]) -> Vec<f64> {
    let mut path = 0.0;
    let steps = centres.windows(2).map(|step| (step[1] - step[0]).norm());
    std::iter::once(0.0)
        .chain(steps)
        .map(|step| {
            path += step;
            path
        })
        .collect()
}

/// RPE of each index pair: inverse true relative motion times estimated relative motion. Poses are
/// `cam_from_world`. The scale of the model must be that of the ground truth; otherwise apply
/// [`crate::PoseComparison::truth_from_model`] by `Sim3::transform_pose` first.
pub fn relative_motion_errors(
    model: &[Rigid3],
    truth: &[Rigid3],
    pairs: &[(usize, usize)],
) -> Vec<MotionError> {
    let motion =
        |poses: &[Rigid3], (start, end): (usize, usize)| poses[start] * poses[end].inverse();
    let error = |pair: &(usize, usize)| {
        let error = motion(truth, *pair).inverse() * motion(model, *pair);
        MotionError { translation: error.translation.norm(), rotation_rad: error.rotation.angle() }
    };
    pairs.iter().map(error).collect()
}

/// Associates each time of the shorter list with the nearest time of the other one, if they differ
/// by at most `max_difference_s`. Both lists are sorted. Returns index pairs into `a_s` and `b_s`.
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
