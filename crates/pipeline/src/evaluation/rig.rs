//! How constant the relative poses of the cameras of a rig are over time.

use std::collections::BTreeMap;

use serde::Serialize;
use tiepoint_eval::geometry::Rigid3;
use tiepoint_eval::{PosePair, RelativePoseSeries, Statistics, associate, relative_pose_series};
use tiepoint_input::sequences::number;
use tiepoint_sfm::scene::{CameraId, Image, Reconstruction};

use crate::evaluation::poses::ErrorStatistics;
use crate::workspace::image_names::stream_of;

/// Statistics of the relative pose of two cameras in a model (p_i of Huang, Elhashash & Qin 2022)
/// over all frames.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RigEvaluation {
    /// Folders of the two cameras.
    pub cameras: [String; 2],
    /// Number of frames: pairs of registered images that are nearest in time.
    pub frames: usize,
    /// Distance of the two cameras, in model units times `scale`, as all lengths here.
    pub baseline: ErrorStatistics,
    /// Root mean square deviation of the second camera's centre from its mean, in the frame of the
    /// first camera.
    pub translation_rms: f64,
    /// Root mean square angle of the relative rotation from its mean, in degrees.
    pub rotation_rms_deg: f64,
    /// Change of the baseline over the drive, from a linear fit over time, as a fraction of its
    /// mean.
    pub baseline_drift: f64,
    /// Length of the change of the centre over the drive, from a linear fit.
    pub translation_drift: f64,
    /// Angle of the change of the rotation over the drive, from a linear fit, in degrees.
    pub rotation_drift_deg: f64,
    /// Times of the frames, in seconds; image numbers where images have no times.
    #[serde(skip)]
    pub times_s: Vec<f64>,
    /// The relative poses, with lengths in units of the model.
    #[serde(skip)]
    pub series: RelativePoseSeries,
}

/// Evaluates every pair of cameras with synchronous images; empty for a single camera. Lengths are
/// multiplied by `scale`: 1 keeps units of the model, [`crate::evaluation::PoseEvaluation::scale`]
/// gives those of the ground truth.
///
/// Images are paired by their times, or, if an image has none, by the numbers in their names.
pub fn evaluate_rig(model: &Reconstruction, scale: f64) -> Vec<RigEvaluation> {
    let has_times = model.registered().all(|(_, image, _)| image.time_s.is_some());
    let time_of = |image: &Image| {
        if has_times { image.time_s } else { number(&image.name).map(|number| number as f64) }
    };
    let mut poses: BTreeMap<CameraId, Vec<(f64, Rigid3)>> = BTreeMap::new();
    for (_, image, pose) in model.registered() {
        if let Some(time_s) = time_of(image) {
            poses.entry(image.camera).or_default().push((time_s, *pose));
        }
    }
    poses.values_mut().for_each(|poses| poses.sort_by(|a, b| a.0.total_cmp(&b.0)));
    let cameras: Vec<CameraPoses> = poses.into_iter().collect();
    let pairs =
        cameras.iter().enumerate().flat_map(|(k, a)| cameras[k + 1..].iter().map(move |b| (a, b)));
    pairs.filter_map(|(a, b)| evaluate_pair(model, a, b, scale)).collect()
}

/// A camera with the times and poses (`cam_from_world`) of its images, in order of time.
type CameraPoses = (CameraId, Vec<(f64, Rigid3)>);

fn evaluate_pair(
    model: &Reconstruction,
    left: &CameraPoses,
    right: &CameraPoses,
    scale: f64,
) -> Option<RigEvaluation> {
    let pairs = synchronous_pairs(&left.1, &right.1)?;
    let series = relative_pose_series(&pairs)?;
    let statistics = |values: Statistics| {
        let Statistics { mean, median, rmse, std, max, .. } = values;
        ErrorStatistics {
            mean: mean * scale,
            median: median * scale,
            rmse: rmse * scale,
            std: std * scale,
            max: max * scale,
        }
    };
    Some(RigEvaluation {
        cameras: [left, right].map(|(camera, _)| stream_of(model, *camera)),
        frames: pairs.len(),
        baseline: statistics(series.baseline),
        translation_rms: series.translation_rms * scale,
        rotation_rms_deg: series.rotation_rms_rad.to_degrees(),
        baseline_drift: series.baseline_drift,
        translation_drift: series.translation_drift * scale,
        rotation_drift_deg: series.rotation_drift_rad.to_degrees(),
        times_s: pairs.iter().map(|pair| pair.time_s).collect(),
        series,
    })
}

/// Pairs of images that are at most half the left camera's median frame interval apart.
fn synchronous_pairs(left: &[(f64, Rigid3)], right: &[(f64, Rigid3)]) -> Option<Vec<PosePair>> {
    let times =
        |poses: &[(f64, Rigid3)]| -> Vec<f64> { poses.iter().map(|(time_s, _)| *time_s).collect() };
    let (left_s, right_s) = (times(left), times(right));
    let intervals: Vec<f64> = left_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let max_difference_s = 0.5 * Statistics::of(&intervals)?.median;
    let pair = |(l, r): (usize, usize)| PosePair {
        time_s: left_s[l],
        left_from_world: left[l].1,
        right_from_world: right[r].1,
    };
    Some(associate(&left_s, &right_s, max_difference_s).into_iter().map(pair).collect())
}
