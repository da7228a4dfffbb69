//! A model with exact rig extrinsics, as COLMAP's rigs and frames express it.
//!
//! The initial extrinsics, the clocks and the incorrect pairs come from mapping. For a model
//! without a rig, they come from the robust mean of the relative poses and
//! [`tiepoint_sfm::rigs::sensor_pairs`]. The images of a frame are those nearest in time. If the
//! cameras are not synchronised, these were taken at different instants, and the motion in between
//! becomes reprojection error; the report has its size.

use std::collections::BTreeSet;
use std::path::Path;

use serde::Serialize;
use tiepoint_sfm::MapperOptions;
use tiepoint_sfm::adjust::AdjustOptions;
use tiepoint_sfm::geometry::nalgebra::{UnitQuaternion, Vector3};
use tiepoint_sfm::geometry::{Rigid3, Sim3};
use tiepoint_sfm::rig::{Clock, RelativePose, robust_average};
use tiepoint_sfm::rigs::{
    ClockState, RigPair, RigidCamera, SensorPair, constrain_rigidly, relative_poses, sensor_pairs,
};
use tiepoint_sfm::scene::{ImageId, Reconstruction};
use tiepoint_sfm::tracks::FilterOptions;

use crate::Error;
use crate::workspace::image_names::{camera_of_stream, stream_of};
use crate::workspace::located_model::LocatedModel;
use crate::workspace::rig_file::{RigCamera, RigFile};
use crate::workspace::sidecar::SIDECAR;

/// The effect of exact rig extrinsics on a model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RigidReport {
    /// Folders of the cameras of the rig; the first one is the reference camera.
    pub cameras: Vec<String>,
    /// Number of frames: instants with a pose of two or more cameras.
    pub frames: usize,
    /// Number of images in frames.
    pub images: usize,
    /// Number of registered images outside frames: without a synchronous image, or incorrect.
    pub free_images: usize,
    /// Mean reprojection error before, in pixels.
    pub error_before_px: f64,
    /// Mean reprojection error with exact extrinsics, in pixels.
    pub error_after_px: f64,
    /// Number of observations before.
    pub observations_before: usize,
    /// Number of observations that remain inliers.
    pub observations_after: usize,
    /// Largest time difference between images of one frame on the clock of the reference camera;
    /// `None` without times.
    pub max_time_difference_s: Option<f64>,
}

/// Largest deviation of a pair from the mean relative pose, without known extrinsics: distance in
/// baselines, and angle in radians.
const MAX_DEVIATION: (f64, f64) = (0.5, 0.1);
/// Minimum number of frames of a camera that joins the rig.
const MIN_PAIRS: usize = 2;
/// Maximum number of Levenberg-Marquardt iterations.
const ITERATIONS: usize = 100;

/// Adjusts a model with exact rig extrinsics.
///
/// # Errors
///
/// The rig names a camera that the model lacks, no two cameras have poses at common frames, or the
/// adjustment fails.
pub(crate) fn rigid_model(located: &LocatedModel) -> Result<(Reconstruction, RigidReport), Error> {
    let mut model = located.reconstruction.clone();
    let (known, bad) = match &located.rig {
        Some(rig) => known_sensors(&model, rig, located.folder())?,
        None => (Vec::new(), BTreeSet::new()),
    };
    let candidates = if known.is_empty() {
        sensor_pairs(&model).into_iter().map(|sensor_pair| (sensor_pair, None)).collect()
    } else {
        known
    };
    let mut cameras: Vec<(RigidCamera, Clock)> = Vec::new();
    for (sensor_pair, calibration) in candidates {
        cameras.extend(
            rigid_camera(&model, &sensor_pair, calibration, &bad)
                .map(|camera| (camera, sensor_pair.clock)),
        );
    }
    if cameras.is_empty() {
        return Err(Error::NoRigFrames { path: located.folder().to_owned() });
    }
    let max_time_difference_s = time_difference_s(&model, &cameras);
    let mut cameras: Vec<RigidCamera> = cameras.into_iter().map(|(camera, _)| camera).collect();
    let (error_before_px, observations_before) =
        (model.mean_reprojection_error_px(), model.num_observations());
    let baseline = cameras[0].cam_from_rig.translation.norm();
    let refine = MapperOptions::default().refine;
    let options = AdjustOptions { refine, max_iterations: ITERATIONS, ..AdjustOptions::default() };
    let options = options.with_noise_of(&model);
    constrain_rigidly(&mut model, &mut cameras, &options, &FilterOptions::default())
        .map_err(Error::adjusting(located.folder()))?;
    // The adjustment is free in scale. The baseline before may be metric.
    let factor = baseline / cameras[0].cam_from_rig.translation.norm();
    if factor.is_normal() {
        let (rotation, translation) = (UnitQuaternion::identity(), Vector3::zeros());
        model.transform(&Sim3 { scale: factor, rotation, translation });
    }
    let images = model.frames.iter().map(|frame| frame.images.len()).sum();
    let names =
        std::iter::once(cameras[0].reference).chain(cameras.iter().map(|camera| camera.other));
    let report = RigidReport {
        cameras: names.map(|camera| stream_of(&model, camera)).collect(),
        frames: model.frames.len(),
        images,
        free_images: model.num_registered() - images,
        error_before_px,
        error_after_px: model.mean_reprojection_error_px(),
        observations_before,
        observations_after: model.num_observations(),
        max_time_difference_s,
    };
    Ok((model, report))
}

/// Pairs of the reference camera and another one with its clock, and `cam_from_rig` if it is known.
type Sensors = Vec<(SensorPair, Option<Rigid3>)>;

/// The cameras of the model's rig, and the images of non-reference sensors in incorrect
/// pairs.
///
/// # Errors
///
/// The rig names a camera that the model lacks.
fn known_sensors(
    model: &Reconstruction,
    rig: &RigFile,
    folder: &Path,
) -> Result<(Sensors, BTreeSet<ImageId>), Error> {
    let find = |name: &str| {
        let camera = camera_of_stream(model, name);
        camera.map(|(id, _)| id).ok_or_else(|| Error::Broken {
            path: folder.join(SIDECAR),
            what: format!("there is no camera {name} in the model"),
        })
    };
    let reference = find(&rig.reference)?;
    let camera = |camera: &RigCamera| {
        let clock = &camera.clock;
        let (offset_s, drift, pivot_s) = (clock.offset_s, 1e-6 * clock.drift_ppm, clock.pivot_s);
        let sensor_pair = SensorPair {
            clock: Clock { offset_s, drift, pivot_s },
            ..SensorPair::synchronised(reference, find(&camera.name)?)
        };
        Ok((sensor_pair, Some(camera.cam_from_rig())))
    };
    let cameras = rig.cameras.iter().map(camera).collect::<Result<_, Error>>()?;
    let names: BTreeSet<&str> = rig.bad_pairs.iter().map(|[_, other]| other.as_str()).collect();
    let bad =
        model.images().filter(|(_, image)| names.contains(image.name.as_str())).map(|(id, _)| id);
    Ok((cameras, bad.collect()))
}

/// A rig sensor with its frames and its initial extrinsics: `calibration`, else the robust mean of
/// the relative poses. `None` if there are too few frames.
fn rigid_camera(
    model: &Reconstruction,
    sensor_pair: &SensorPair,
    calibration: Option<Rigid3>,
    bad: &BTreeSet<ImageId>,
) -> Option<RigidCamera> {
    // As synchronised cameras: images are paired by their clocks, whatever the time between them.
    let sensor_pair = SensorPair { clock_state: ClockState::Synchronised, ..*sensor_pair };
    let pairs: Vec<RigPair> = sensor_pair
        .referenced_images(model)
        .iter()
        .filter(|image| !bad.contains(&image.image))
        .map(|image| RigPair {
            reference: image.nearest_reference(&sensor_pair.clock),
            other: image.image,
        })
        .collect();
    let poses = relative_poses(model, &pairs);
    let (cam_from_rig, pairs) = match calibration {
        Some(known) => (known, pairs),
        None => {
            let all: Vec<RelativePose> = poses.iter().map(|(_, pose)| *pose).collect();
            let average = robust_average(&all)?;
            let is_near = |pose: &RelativePose| {
                let (distance, angle) = pose.distance_and_angle(&average);
                distance <= MAX_DEVIATION.0 * average.translation.norm() && angle <= MAX_DEVIATION.1
            };
            (
                average.cam_from_rig(),
                poses.into_iter().filter(|(_, pose)| is_near(pose)).map(|(pair, _)| pair).collect(),
            )
        }
    };
    let SensorPair { reference, other, .. } = sensor_pair;
    (pairs.len() >= MIN_PAIRS).then_some(RigidCamera { reference, other, cam_from_rig, pairs })
}

/// Largest time difference between the two images of a pair, on the reference clock.
fn time_difference_s(model: &Reconstruction, cameras: &[(RigidCamera, Clock)]) -> Option<f64> {
    let all = cameras
        .iter()
        .flat_map(|(camera, clock)| camera.pairs.iter().map(move |pair| (pair, clock)));
    let difference_s = |(pair, clock): (&RigPair, &Clock)| {
        let other_s = clock.reference_time_s(model.image(pair.other).time_s?);
        Some((other_s - model.image(pair.reference).time_s?).abs())
    };
    all.map(difference_s).try_fold(0.0, |max: f64, seconds| Some(max.max(seconds?)))
}
