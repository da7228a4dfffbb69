//! The relative pose of two cameras over time. On a rig it is constant, so that its variation and
//! its drift measure errors of a reconstruction without ground truth.

use tiepoint_geometry::nalgebra::{UnitQuaternion, Vector3};
use tiepoint_geometry::{Rigid3, so3};

use crate::Statistics;

/// Iterations of rotation averaging; each squares the (small) error.
const AVERAGING_ITERATIONS: usize = 10;

/// The poses of two cameras in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePair {
    /// Time of the frame, in seconds.
    pub time_s: f64,
    /// Pose of the first camera.
    pub left_from_world: Rigid3,
    /// Pose of the second camera.
    pub right_from_world: Rigid3,
}

/// Statistics of the relative pose of two cameras over all frames. Lengths are in units of the
/// model.
#[derive(Clone, Debug, PartialEq)]
pub struct RelativePoseSeries {
    /// Mean relative pose.
    pub right_from_left: Rigid3,
    /// Centre of the right camera in the frame of the left one, per frame.
    pub centres: Vec<Vector3<f64>>,
    /// Rotation vector of the deviation of the relative rotation from its mean, per frame, in
    /// radians.
    pub rotations_rad: Vec<Vector3<f64>>,
    /// Distances of the two cameras.
    pub baseline: Statistics,
    /// Root mean square distance of `centres` from their mean.
    pub translation_rms: f64,
    /// Root mean square angle of the relative rotation from its mean, in radians.
    pub rotation_rms_rad: f64,
    /// Scale drift: change of the baseline from the first to the last frame, from a linear fit over
    /// time, as a fraction of its mean.
    pub baseline_drift: f64,
    /// Length of the change of the centre, from a linear fit.
    pub translation_drift: f64,
    /// Angle of the change of the rotation, from a linear fit, in radians.
    pub rotation_drift_rad: f64,
}

/// Computes the relative poses of the frames and their statistics; `None` for fewer than two
/// frames.
pub fn relative_pose_series(pairs: &[PosePair]) -> Option<RelativePoseSeries> {
    if pairs.len() < 2 {
        return None;
    }
    let count = pairs.len() as f64;
    let mean = |values: &[Vector3<f64>]| values.iter().sum::<Vector3<f64>>() / count;
    let rms_from = |values: &[Vector3<f64>], middle: Vector3<f64>| {
        (values.iter().map(|value| (value - middle).norm_squared()).sum::<f64>() / count).sqrt()
    };
    let relative = |pair: &PosePair| pair.right_from_world * pair.left_from_world.inverse();
    let relative: Vec<Rigid3> = pairs.iter().map(relative).collect();
    let centres: Vec<Vector3<f64>> = relative.iter().map(Rigid3::origin_in_a).collect();
    let rotation = mean_rotation(&relative);
    let rotations_rad: Vec<Vector3<f64>> =
        relative.iter().map(|pose| so3::log(&(pose.rotation * rotation.inverse()))).collect();
    let centre = mean(&centres);
    let times: Vec<f64> = pairs.iter().map(|pair| pair.time_s).collect();
    let lengths: Vec<Vector3<f64>> = centres.iter().map(|c| Vector3::x() * c.norm()).collect();
    let baselines: Vec<f64> = lengths.iter().map(|length| length.x).collect();
    let baseline = Statistics::of(&baselines)?;
    Some(RelativePoseSeries {
        right_from_left: Rigid3::new(rotation, -(rotation * centre)),
        translation_rms: rms_from(&centres, centre),
        rotation_rms_rad: rms_from(&rotations_rad, Vector3::zeros()),
        baseline_drift: linear_drift(&times, &lengths).x / baseline.mean,
        translation_drift: linear_drift(&times, &centres).norm(),
        rotation_drift_rad: linear_drift(&times, &rotations_rad).norm(),
        baseline,
        centres,
        rotations_rad,
    })
}

/// Geodesic L2 mean of the rotations (Hartley et al. 2013, "Rotation Averaging"): the rotation
/// vectors of the deviations from it sum to zero.
fn mean_rotation(poses: &[Rigid3]) -> UnitQuaternion<f64> {
    // Any of the rotations is a good start.
    let mut mean = poses[poses.len() / 2].rotation;
    for _ in 0..AVERAGING_ITERATIONS {
        let sum: Vector3<f64> =
            poses.iter().map(|pose| so3::log(&(pose.rotation * mean.inverse()))).sum();
        mean = so3::exp(&(sum / poses.len() as f64)) * mean;
    }
    mean
}

/// Change from the first to the last time of a least-squares line through the values; zero if all
/// times are equal.
fn linear_drift(times: &[f64], values: &[Vector3<f64>]) -> Vector3<f64> {
    let count = times.len() as f64;
    let middle = times.iter().sum::<f64>() / count;
    let mean = values.iter().sum::<Vector3<f64>>() / count;
    let variance: f64 = times.iter().map(|time| (time - middle).powi(2)).sum();
    if variance == 0.0 {
        return Vector3::zeros();
    }
    let covariance: Vector3<f64> =
        times.iter().zip(values).map(|(time, value)| (value - mean) * (time - middle)).sum();
    let (first, last) =
        times.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(*t), b.max(*t)));
    covariance / variance * (last - first)
}
