//! The calibration of a rig from its relative poses at many moments, some of them wrong.
//!
//! The geometric median of the centres (Weiszfeld 1937) and the L1 mean of the rotations (Hartley,
//! Aftab & Trumpf 2011): one bad moment in two would be needed to carry them off, where one in
//! forty carries off a mean.

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::numeric::median;
use tiepoint_geometry::so3;

use crate::RelativePose;

/// Rounds of Weiszfeld's iteration; it converges linearly, and what is left is far below the
/// spread.
const ROUNDS: usize = 100;
/// Distances below this share of the median count as this, so that a datum that is met does not
/// become a trap.
const FLOOR: f64 = 1e-6;

/// The relative pose nearest to all in the sum of distances, rotation and translation apart; `None`
/// without any.
pub fn robust_average(poses: &[RelativePose]) -> Option<RelativePose> {
    if poses.is_empty() {
        return None;
    }
    let centres: Vec<Vector3<f64>> = poses.iter().map(|pose| pose.translation).collect();
    let translation = {
        let mut centre = componentwise_median(&centres);
        for _ in 0..ROUNDS {
            let offsets: Vec<Vector3<f64>> = centres.iter().map(|c| c - centre).collect();
            centre += weiszfeld_step(&offsets);
        }
        centre
    };
    // The rotation with the least sum of angles to the others is a safe start.
    let rotations: Vec<_> = poses.iter().map(|pose| so3::exp(&pose.axis_angle)).collect();
    let cost =
        |index: &usize| rotations.iter().map(|r| r.angle_to(&rotations[*index])).sum::<f64>();
    let step = rotations.len().div_ceil(MAX_STARTS);
    let start = (0..rotations.len()).step_by(step).min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
    let mut rotation = rotations[start];
    for _ in 0..ROUNDS {
        let offsets: Vec<Vector3<f64>> =
            rotations.iter().map(|r| so3::log(&(r * rotation.inverse()))).collect();
        rotation = so3::exp(&weiszfeld_step(&offsets)) * rotation;
    }
    Some(RelativePose { translation, axis_angle: so3::log(&rotation) })
}

/// Starts considered for the rotation; each costs as many angles as there are moments.
const MAX_STARTS: usize = 64;

/// Infinite of nothing.
pub(crate) fn componentwise_median(values: &[Vector3<f64>]) -> Vector3<f64> {
    Vector3::from_fn(|row, _| {
        let mut column: Vec<f64> = values.iter().map(|value| value[row]).collect();
        median(&mut column).unwrap_or(f64::INFINITY)
    })
}

/// The mean of the offsets, each weighed by one over its length.
fn weiszfeld_step(offsets: &[Vector3<f64>]) -> Vector3<f64> {
    let lengths: Vec<f64> = offsets.iter().map(|offset| offset.norm()).collect();
    let floor = (FLOOR * median(&mut lengths.clone()).unwrap_or(0.0)).max(f64::MIN_POSITIVE.sqrt());
    let weights: Vec<f64> = lengths.into_iter().map(|length| 1.0 / length.max(floor)).collect();
    let sum: Vector3<f64> =
        offsets.iter().zip(&weights).map(|(offset, weight)| offset * *weight).sum();
    sum / weights.iter().sum::<f64>()
}
