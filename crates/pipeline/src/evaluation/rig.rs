//! How constant the relative poses of the cameras of a rig are over time.

use std::collections::BTreeMap;

use serde::Serialize;
use tiepoint_eval::geometry::Rigid3;
use tiepoint_eval::{PosePair, RelativePoseSeries, Statistics, associate, relative_pose_series};
use tiepoint_input::sequences::number;
use tiepoint_sfm::rigs::{ReferencedImage, SensorPair, rig_candidates};
use tiepoint_sfm::scene::{CameraId, Image, Reconstruction};

use crate::evaluation::poses::ErrorStatistics;
use crate::workspace::image_names::stream_of;
use crate::workspace::rig_file::RigFile;

/// Statistics of the relative pose of two cameras in a model (p_i of Huang, Elhashash & Qin 2022)
/// over all frames.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RigEvaluation {
    /// Folders of the two cameras.
    pub cameras: [String; 2],
    /// Number of frames. With the clock of a rig: images of the second camera at whose times the
    /// first has a (synchronous or interpolated) pose, without those that contradict the
    /// extrinsics. Else pairs of registered images that are nearest in time.
    pub frames: usize,
    /// Whether the clock of a rig relates the times of the two cameras.
    pub has_clock: bool,
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
    /// Whether `times_s` are times.
    #[serde(skip)]
    pub has_times: bool,
    /// Times of the frames, in seconds; image numbers where images have no times.
    #[serde(skip)]
    pub times_s: Vec<f64>,
    /// The relative poses, with lengths in units of the model.
    #[serde(skip)]
    pub series: RelativePoseSeries,
}

/// Evaluates every pair of cameras that may be on a rig ([`rig_candidates`]) and whose images are
/// related in time; empty for a single camera, also one that was turned or zoomed.
/// Lengths are multiplied by `scale`: 1 keeps units of the model,
/// [`crate::evaluation::PoseEvaluation::scale`] gives those of the ground truth.
///
/// The cameras of `rig` are compared with its reference camera, at the times of its clocks. Other
/// images are paired by their times, or, if an image has none, by the numbers in their names.
pub fn evaluate_rig(
    model: &Reconstruction,
    rig: Option<&RigFile>,
    scale: f64,
) -> Vec<RigEvaluation> {
    let has_times = model.registered().all(|(_, image, _)| image.time_s.is_some());
    let time_of = |image: &Image| {
        if has_times { image.time_s } else { number(&image.name).map(|number| number as f64) }
    };
    let candidates = rig_candidates(model);
    let mut poses: BTreeMap<CameraId, Vec<(f64, Rigid3)>> = BTreeMap::new();
    for (_, image, pose) in model.registered() {
        let is_candidate = candidates.contains_key(&image.camera);
        if let Some(time_s) = time_of(image).filter(|_| is_candidate) {
            poses.entry(image.camera).or_default().push((time_s, *pose));
        }
    }
    poses.values_mut().for_each(|poses| poses.sort_by(|a, b| a.0.total_cmp(&b.0)));
    let cameras: Vec<CameraPoses> = poses.into_iter().collect();
    let names: BTreeMap<CameraId, String> =
        cameras.iter().map(|(camera, _)| (*camera, stream_of(model, *camera))).collect();
    let pairs =
        cameras.iter().enumerate().flat_map(|(k, a)| cameras[k + 1..].iter().map(move |b| (a, b)));
    let evaluate = |(left, right): (&CameraPoses, &CameraPoses)| {
        let cameras = [left, right].map(|(camera, _)| names[camera].clone());
        let has_clock = rig.is_some_and(|rig| cameras.iter().all(|name| rig.has_camera(name)));
        let pairs = if has_clock {
            poses_at_clock(model, rig?, [left.0, right.0], &cameras, &time_of)?
        } else {
            synchronous_pairs(&left.1, &right.1)?
        };
        let of_pair = evaluation(cameras, has_clock, &pairs, scale)?;
        Some(RigEvaluation { has_times, ..of_pair })
    };
    pairs.filter_map(evaluate).collect()
}

/// A camera with the times and poses (`cam_from_world`) of its images, in order of time.
type CameraPoses = (CameraId, Vec<(f64, Rigid3)>);

/// The poses of a camera of a rig and those of the reference camera at the same times; `None` if
/// neither is the reference camera.
fn poses_at_clock(
    model: &Reconstruction,
    rig: &RigFile,
    [left, right]: [CameraId; 2],
    names: &[String; 2],
    time_of: &dyn Fn(&Image) -> Option<f64>,
) -> Option<Vec<PosePair>> {
    let is_left = names[0] == rig.reference;
    let (reference, other, name) =
        if is_left { (left, right, &names[1]) } else { (right, left, &names[0]) };
    (is_left || names[1] == rig.reference).then_some(())?;
    let camera = rig.cameras.iter().find(|camera| camera.name == *name)?;
    let clock = camera.clock.clock();
    // Numbers of frames are scaled to the seconds that the clock counts, and back.
    let unit_s = camera.clock.assumed_frame_s.unwrap_or(1.0);
    let sensor_pair = SensorPair {
        clock,
        clock_state: camera.clock.state.into(),
        ..SensorPair::synchronised(reference, other)
    };
    let contradicts = |image: &Image| rig.bad_pairs.iter().any(|[_, bad]| *bad == image.name);
    let pair = |referenced: &ReferencedImage| {
        let image = model.image(referenced.image);
        let of_reference = referenced.rig_from_world(model, &clock)?;
        let of_other = *image.cam_from_world()?;
        let (left_from_world, right_from_world) =
            if is_left { (of_reference, of_other) } else { (of_other, of_reference) };
        let time_s = clock.reference_time_s(time_of(image)? * unit_s) / unit_s;
        (!contradicts(image)).then_some(PosePair { time_s, left_from_world, right_from_world })
    };
    Some(sensor_pair.referenced_images(model).iter().filter_map(pair).collect())
}

fn evaluation(
    cameras: [String; 2],
    has_clock: bool,
    pairs: &[PosePair],
    scale: f64,
) -> Option<RigEvaluation> {
    let series = relative_pose_series(pairs)?;
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
        cameras,
        frames: pairs.len(),
        has_clock,
        baseline: statistics(series.baseline),
        translation_rms: series.translation_rms * scale,
        rotation_rms_deg: series.rotation_rms_rad.to_degrees(),
        baseline_drift: series.baseline_drift,
        translation_drift: series.translation_drift * scale,
        rotation_drift_deg: series.rotation_drift_rad.to_degrees(),
        has_times: true,
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
