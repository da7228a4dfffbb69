//! The relative pose of two cameras over time: of a rig it is constant, so its spread and its drift
//! measure a reconstruction without any truth.

use tiepoint_geometry::nalgebra::{UnitQuaternion, Vector3};
use tiepoint_geometry::{Rigid3, so3};

use crate::Statistics;

/// Rounds of averaging rotations on the manifold; each squares the (small) error.
const AVERAGING_ROUNDS: usize = 10;

/// Two cameras at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePair {
    /// When, in seconds.
    pub time_s: f64,
    /// The first camera's pose.
    pub left_from_world: Rigid3,
    /// The second camera's pose.
    pub right_from_world: Rigid3,
}

/// How the relative pose of two cameras deviates from its mean; lengths in units of the model.
#[derive(Clone, Debug, PartialEq)]
pub struct RelativePoseSeries {
    /// The mean, over all pairs.
    pub right_from_left: Rigid3,
    /// For each pair the right camera's centre in the left camera's frame.
    pub centres: Vec<Vector3<f64>>,
    /// For each pair the rotation vector of its relative rotation from the mean one, in radians.
    pub rotations_rad: Vec<Vector3<f64>>,
    /// Distances of the two cameras.
    pub baseline: Statistics,
    /// Root mean square distance of the right camera's centre from its mean, in the left camera's
    /// frame.
    pub translation_rms: f64,
    /// Root mean square angle of the relative rotation from its mean.
    pub rotation_rms_rad: f64,
    /// What the scale does: the baseline's change from the first moment to the last by a straight
    /// line through all, as a part of its mean.
    pub baseline_drift: f64,
    /// The same of the centre, as a distance.
    pub translation_drift: f64,
    /// The same of the rotation, as an angle.
    pub rotation_drift_rad: f64,
}

/// Measures the relative poses of pairs; `None` for fewer than two.
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
        baseline_drift: change(&times, &lengths).x / baseline.mean,
        translation_drift: change(&times, &centres).norm(),
        rotation_drift_rad: change(&times, &rotations_rad).norm(),
        baseline,
        centres,
        rotations_rad,
    })
}

/// The rotation from which the others deviate by rotation vectors that add up to nothing (Hartley
/// et al. 2013).
fn mean_rotation(poses: &[Rigid3]) -> UnitQuaternion<f64> {
    // One of those in the middle of the drive is as good a start as any.
    let mut mean = poses[poses.len() / 2].rotation;
    for _ in 0..AVERAGING_ROUNDS {
        let sum: Vector3<f64> =
            poses.iter().map(|pose| so3::log(&(pose.rotation * mean.inverse()))).sum();
        mean = so3::exp(&(sum / poses.len() as f64)) * mean;
    }
    mean
}

/// What a straight line through values changes by, from the first time to the last (least squares).
/// Nothing where all times are one.
fn change(times: &[f64], values: &[Vector3<f64>]) -> Vector3<f64> {
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
