//! Robust average of relative poses over many frames, for the initial rig extrinsics.
//!
//! It is the geometric median of the centres (Weiszfeld 1937) and the L1 mean of the rotations
//! (Hartley, Aftab & Trumpf 2011). Both tolerate up to half of the frames as outliers, while one
//! outlier in forty spoils a mean.

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::numeric::median;
use tiepoint_geometry::so3;

use crate::RelativePose;

/// Iterations of Weiszfeld's algorithm. It converges linearly, and after these the error is far
/// below the spread.
const ITERATIONS: usize = 100;
/// Lower bound of distances, as a fraction of their median. Without it, an iterate on a data point
/// would stay there.
const MIN_DISTANCE: f64 = 1e-6;

/// The relative pose with the smallest sum of distances to all others, separately for translation
/// and rotation; `None` if there are none.
pub fn robust_average(poses: &[RelativePose]) -> Option<RelativePose> {
    if poses.is_empty() {
        return None;
    }
    let centres: Vec<Vector3<f64>> = poses.iter().map(|pose| pose.translation).collect();
    let translation = {
        let mut centre = componentwise_median(&centres);
        for _ in 0..ITERATIONS {
            let offsets: Vec<Vector3<f64>> = centres.iter().map(|c| c - centre).collect();
            centre += weiszfeld_step(&offsets);
        }
        centre
    };
    // Start: the rotation with the smallest sum of angles to the others.
    let rotations: Vec<_> = poses.iter().map(|pose| so3::exp(&pose.axis_angle)).collect();
    let cost =
        |index: &usize| rotations.iter().map(|r| r.angle_to(&rotations[*index])).sum::<f64>();
    let step = rotations.len().div_ceil(MAX_STARTS);
    let start = (0..rotations.len()).step_by(step).min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
    let mut rotation = rotations[start];
    for _ in 0..ITERATIONS {
        let offsets: Vec<Vector3<f64>> =
            rotations.iter().map(|r| so3::log(&(r * rotation.inverse()))).collect();
        rotation = so3::exp(&weiszfeld_step(&offsets)) * rotation;
    }
    Some(RelativePose { translation, axis_angle: so3::log(&rotation) })
}

/// Rotations that are tried as start. Each costs one angle per frame.
const MAX_STARTS: usize = 64;

/// Infinite if there are no values.
pub(crate) fn componentwise_median(values: &[Vector3<f64>]) -> Vector3<f64> {
    Vector3::from_fn(|row, _| {
        let mut column: Vec<f64> = values.iter().map(|value| value[row]).collect();
        median(&mut column).unwrap_or(f64::INFINITY)
    })
}

/// Weiszfeld step: the mean of the offsets, weighted by their inverse lengths.
fn weiszfeld_step(offsets: &[Vector3<f64>]) -> Vector3<f64> {
    let lengths: Vec<f64> = offsets.iter().map(|offset| offset.norm()).collect();
    let min_distance =
        (MIN_DISTANCE * median(&mut lengths.clone()).unwrap_or(0.0)).max(f64::MIN_POSITIVE.sqrt());
    let weights: Vec<f64> =
        lengths.into_iter().map(|length| 1.0 / length.max(min_distance)).collect();
    let sum: Vector3<f64> =
        offsets.iter().zip(&weights).map(|(offset, weight)| offset * *weight).sum();
    sum / weights.iter().sum::<f64>()
}
