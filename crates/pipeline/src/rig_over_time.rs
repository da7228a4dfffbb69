//! The relative poses of cameras that ride together, over time.

use std::collections::BTreeMap;

use serde::Serialize;
use tiepoint_eval::geometry::Rigid3;
use tiepoint_eval::{PosePair, RigOverTime, Statistics, associate, rig_over_time};
use tiepoint_sfm::scene::{CameraId, Image, Reconstruction};

use crate::ErrorStatistics;
use crate::image_names::{folder_of, number};

/// How constant the relative pose of two cameras is in a model: p_i of the paper, its spread and
/// its drift.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RigEvaluation {
    /// The folders of the two cameras.
    pub cameras: [String; 2],
    /// Moments at which both have a pose: their images nearest in time.
    pub moments: usize,
    /// Distance of the two cameras, in the unit asked for.
    pub baseline: ErrorStatistics,
    /// Root mean square deviation of the second camera's centre, seen from the first, from its
    /// mean; in that unit.
    pub translation_rms: f64,
    /// The same of the rotation.
    pub rotation_rms_deg: f64,
    /// Change of the baseline over the drive (by a straight line through all moments), as a part of
    /// its mean.
    pub baseline_drift: f64,
    /// Change of the centre over the drive, in that unit.
    pub translation_drift: f64,
    /// Change of the rotation over the drive.
    pub rotation_drift_deg: f64,
    /// Times of the moments, in seconds; numbers of images where there are no times.
    #[serde(skip)]
    pub times_s: Vec<f64>,
    /// The relative poses themselves; lengths in units of the model.
    #[serde(skip)]
    pub series: RigOverTime,
}

/// Measures every pair of a model's cameras that took images at the same moments; none for a lone
/// camera. Lengths are multiplied by `scale`: 1 leaves the model's units,
/// [`crate::PoseEvaluation::scale`] gives those of the truth.
///
/// Images pair up by their times, or, where an image has none, by the numbers in their names.
pub fn evaluate_rig(model: &Reconstruction, scale: f64) -> Vec<RigEvaluation> {
    let has_times = model.registered().all(|(_, image, _)| image.time_s.is_some());
    let time_of = |image: &Image| {
        if has_times { image.time_s } else { number(&image.name).map(|number| number as f64) }
    };
    let mut drives: BTreeMap<CameraId, Vec<(f64, Rigid3)>> = BTreeMap::new();
    for (_, image, pose) in model.registered() {
        if let Some(time_s) = time_of(image) {
            drives.entry(image.camera).or_default().push((time_s, *pose));
        }
    }
    drives.values_mut().for_each(|drive| drive.sort_by(|a, b| a.0.total_cmp(&b.0)));
    let drives: Vec<(CameraId, Vec<(f64, Rigid3)>)> = drives.into_iter().collect();
    let pairs =
        drives.iter().enumerate().flat_map(|(k, a)| drives[k + 1..].iter().map(move |b| (a, b)));
    pairs.filter_map(|(a, b)| evaluate_pair(model, a, b, scale)).collect()
}

type Drive = (CameraId, Vec<(f64, Rigid3)>);

fn evaluate_pair(
    model: &Reconstruction,
    left: &Drive,
    right: &Drive,
    scale: f64,
) -> Option<RigEvaluation> {
    let pairs = moments(&left.1, &right.1)?;
    let series = rig_over_time(&pairs)?;
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
        cameras: [left, right].map(|(camera, _)| folder_of(model, *camera)),
        moments: pairs.len(),
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

/// Images of both at most half an interval apart.
fn moments(left: &[(f64, Rigid3)], right: &[(f64, Rigid3)]) -> Option<Vec<PosePair>> {
    let times =
        |drive: &[(f64, Rigid3)]| -> Vec<f64> { drive.iter().map(|(time_s, _)| *time_s).collect() };
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
