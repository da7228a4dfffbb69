//! Merges the models of two cameras on one rig that have no common points, from their motion.
//!
//! The models differ by a similarity, and the cameras by their extrinsics: hand-eye calibration
//! with unknown scale. The clock offset maximises the agreement of the cameras' rotation rates,
//! which do not depend on a frame. Two steps then alternate: the similarity that aligns the second
//! camera's centres with those predicted from the first camera's motion and the extrinsics (Umeyama
//! 1991), and the extrinsics as the robust average of the relative poses. A part of the extrinsics
//! that the motion does not determine stays at zero, for example the translation along the common
//! axis of all rotations (Tsai & Lenz 1989). The result initialises the rig constraint.

use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::numeric::median;
use tiepoint_geometry::solvers::umeyama;
use tiepoint_geometry::{Rigid3, Sim3};
use tiepoint_rig::{RelativePose, Trajectory, robust_average};
use tiepoint_scene::{CameraId, ImageId, Reconstruction, Track};

use crate::timeline::posed_in_time;

/// Search range of the offset in seconds, and number of steps per interval between images.
const MAX_OFFSET_S: f64 = 1.5;
const STEPS_PER_INTERVAL: f64 = 8.0;
/// Minimum standard deviation of the rotation rate, in radians a second. Below it the time stamps
/// are used.
const MIN_RATE_SCATTER: f64 = 0.02;
/// Minimum number of common times.
const MIN_COMMON_TIMES: usize = 8;
/// Alternations. The error decreases by the ratio of baseline to trajectory extent in each.
const ROUNDS: usize = 30;
/// Maximum median deviations from the extrinsics: distance relative to the trajectory's extent, and
/// rotation in radians. The tolerance allows for drift; cameras on different vehicles exceed it.
const MAX_DEVIATION: f64 = 0.05;
const MAX_ROTATION_RAD: f64 = 0.1;

/// Poses with their times in seconds.
type TimedPoses = Vec<(f64, Rigid3)>;

/// Merges two models in the frame of the first. Returns `None` if they share a camera, if times are
/// missing, or if their motions do not fit one rig.
pub(crate) fn merge_by_motion(
    first: &Reconstruction,
    second: &Reconstruction,
) -> Option<Reconstruction> {
    if !first.registered_cameras().is_disjoint(&second.registered_cameras()) {
        return None;
    }
    let references = timed_poses(first, *first.registered_cameras().first()?);
    let others = second.registered_cameras().into_iter().map(|camera| timed_poses(second, camera));
    let others = others.max_by_key(Vec::len)?;
    let first_from_second = similarity(&Trajectory::new(references), &others)?;
    let mut merged = first.clone();
    let mut moved = second.clone();
    moved.transform(&first_from_second);
    for camera in second.registered_cameras() {
        merged.copy_camera(&moved, camera);
    }
    let posed: Vec<(ImageId, Rigid3)> =
        moved.registered().map(|(id, _, pose)| (id, *pose)).collect();
    for (image, pose) in posed {
        merged.register(image, pose);
        let pixels: Vec<_> =
            moved.image(image).keypoints.iter().map(|keypoint| keypoint.pixel).collect();
        merged.move_keypoints(image, &pixels);
    }
    for (_, track) in moved.tracks() {
        merged.add_track(Track::new(track.xyz, track.observations.clone()));
    }
    // Rigs and frames of the separate models no longer hold.
    merged.rigs.clear();
    merged.frames.clear();
    Some(merged)
}

/// The registered images of a camera: times in seconds and `cam_from_world`, in order of time.
fn timed_poses(model: &Reconstruction, camera: CameraId) -> TimedPoses {
    posed_in_time(model, camera).into_iter().map(|(time_s, _, pose)| (time_s, pose)).collect()
}

/// Returns the similarity from the world frame of `others` to that of `references`.
fn similarity(references: &Trajectory, others: &[(f64, Rigid3)]) -> Option<Sim3> {
    let offset_s = offset_s(references, others);
    let both = |(time_s, other): &(f64, Rigid3)| Some((references.at(time_s + offset_s)?, *other));
    let poses: Vec<(Rigid3, Rigid3)> = others.iter().filter_map(both).collect();
    if poses.len() < MIN_COMMON_TIMES {
        return None;
    }
    let from: Vec<Vector3<f64>> = poses.iter().map(|(_, other)| other.origin_in_a()).collect();
    let mut extrinsics = Rigid3::identity();
    let mut found = None;
    for _ in 0..ROUNDS {
        let to: Vec<Vector3<f64>> =
            poses.iter().map(|(reference, _)| (extrinsics * *reference).origin_in_a()).collect();
        let similarity = umeyama(&from, &to, true)?;
        let relative: Vec<RelativePose> = poses
            .iter()
            .map(|(reference, other)| {
                RelativePose::between(reference, &similarity.transform_pose(other))
            })
            .collect();
        let average = robust_average(&relative)?;
        extrinsics = average.cam_from_rig();
        found = Some((similarity, relative, average, extent(&to)));
    }
    let (similarity, relative, average, extent) = found?;
    let (mut deviations, mut rotations): (Vec<f64>, Vec<f64>) =
        relative.iter().map(|p| p.distance_and_angle(&average)).unzip();
    let is_rigid = median(&mut deviations)? <= MAX_DEVIATION * extent
        && median(&mut rotations)? <= MAX_ROTATION_RAD;
    is_rigid.then_some(similarity)
}

/// Root mean square distance from the centroid.
fn extent(points: &[Vector3<f64>]) -> f64 {
    let count = points.len() as f64;
    let centroid = points.iter().sum::<Vector3<f64>>() / count;
    (points.iter().map(|point| (point - centroid).norm_squared()).sum::<f64>() / count).sqrt()
}

/// Returns the offset, to be added to the second camera's times, at which the rotation rates agree
/// best.
fn offset_s(references: &Trajectory, others: &[(f64, Rigid3)]) -> f64 {
    let others: Vec<(f64, f64)> = others
        .windows(2)
        .filter(|pair| pair[1].0 > pair[0].0)
        .map(|pair| {
            let ((a_s, a), (b_s, b)) = (&pair[0], &pair[1]);
            (0.5 * (a_s + b_s), b.rotation.angle_to(&a.rotation) / (b_s - a_s))
        })
        .collect();
    let half_s = 0.5 * references.interval_s();
    let rate = |time_s: f64| {
        let (a, b) = (references.at(time_s - half_s)?, references.at(time_s + half_s)?);
        Some(a.rotation.angle_to(&b.rotation) / (2.0 * half_s))
    };
    let mean = others.iter().map(|(_, rate)| rate).sum::<f64>() / others.len().max(1) as f64;
    let scatter = others.iter().map(|(_, rate)| (rate - mean).powi(2)).sum::<f64>()
        / others.len().max(1) as f64;
    if !half_s.is_finite() || scatter.sqrt() < MIN_RATE_SCATTER {
        return 0.0;
    }
    let cost = |offset_s: f64| {
        let squares: Vec<f64> = others
            .iter()
            .filter_map(|(time_s, other)| Some((rate(time_s + offset_s)? - other).powi(2)))
            .collect();
        let is_enough = squares.len() >= MIN_COMMON_TIMES && 2 * squares.len() >= others.len();
        if is_enough { squares.iter().sum::<f64>() / squares.len() as f64 } else { f64::INFINITY }
    };
    let step_s = references.interval_s() / STEPS_PER_INTERVAL;
    let steps = (MAX_OFFSET_S / step_s).ceil() as i64;
    let offsets = (-steps..=steps).map(|step| step as f64 * step_s);
    // Ties go to the smallest offset.
    offsets
        .map(|offset_s| (cost(offset_s), offset_s))
        .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.abs().total_cmp(&b.1.abs())))
        .map_or(0.0, |(_, offset_s)| offset_s)
}
