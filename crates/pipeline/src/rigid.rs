//! A workspace's model with its cameras held exactly to one calibration: what rigs and frames of
//! COLMAP can say.
//!
//! The calibration, clocks and wrong pairs are those that mapping found (`rig.json`); where it held
//! nothing, the robust mean of the relative poses and [`tiepoint_sfm::rig_sensors`]. Images of one
//! moment are then those nearest to each other in time. Where cameras are not triggered together,
//! that is not the same instant, and what the rig moved in between becomes error: the report says
//! how much.

use std::collections::BTreeSet;
use std::path::Path;

use serde::Serialize;
use tiepoint_io::colmap::read_model;
use tiepoint_sfm::geometry::nalgebra::{UnitQuaternion, Vector3};
use tiepoint_sfm::geometry::{Rigid3, Sim3};
use tiepoint_sfm::rig::{Clock, RelativePose, robust_average};
use tiepoint_sfm::scene::{ImageId, Reconstruction};
use tiepoint_sfm::{
    AdjustOptions, ClockState, FilterOptions, MapperOptions, RefineIntrinsics, RigPair, RigSensor,
    RigidCamera, constrain_rigidly, relative_poses, rig_sensors,
};

use crate::evaluate::read_times;
use crate::image_names::{camera_of_folder, folder_of};
use crate::model_location::ModelLocation;
use crate::{Error, Report, RigCamera, RigFile, model_folder};

/// What it took to make a model rigid.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RigidReport {
    /// The cameras on the rig, the first one being its frame.
    pub cameras: Vec<String>,
    /// Moments at which two or more of them have a pose: frames of the rig.
    pub frames: usize,
    /// Images in them.
    pub images: usize,
    /// Images that stay free: without a partner, or known to be wrong.
    pub free_images: usize,
    /// Mean reprojection error of the model as it was.
    pub error_before_px: f64,
    /// The same of the rigid one.
    pub error_after_px: f64,
    /// Observations as they were.
    pub observations_before: usize,
    /// Those that still fit.
    pub observations_after: usize,
    /// Largest difference in time between images of one frame, by the clocks that were found;
    /// `None` without times.
    pub max_time_difference_s: Option<f64>,
}

/// Without a mounting found before, a pair farther than this from the mean is none: in baselines,
/// and in radians.
const MAX_DEVIATION: (f64, f64) = (0.5, 0.1);
const MIN_PAIRS: usize = 2;
const ITERATIONS: usize = 100;

/// Reads a model (a folder, or a workspace) and makes it rigid.
pub(crate) fn rigid_model(from: &Path) -> Result<(Reconstruction, RigidReport), Error> {
    let folder = model_folder(from)?;
    let place = ModelLocation::of(&folder);
    let mut model = read_model(&folder)?;
    read_times(&mut model, &place.timestamps())?;
    let rig = place.rig();
    let (found, bad) =
        if rig.is_file() { mounted(&model, &place)? } else { (Vec::new(), BTreeSet::new()) };
    let candidates = if found.is_empty() {
        rig_sensors(&model).into_iter().map(|rig_sensor| (rig_sensor, None)).collect()
    } else {
        found
    };
    let mut cameras: Vec<(RigidCamera, Clock)> = Vec::new();
    for (rig_sensor, calibration) in candidates {
        cameras.extend(
            rigid_camera(&model, &rig_sensor, calibration, &bad)
                .map(|camera| (camera, rig_sensor.clock)),
        );
    }
    if cameras.is_empty() {
        return Err(Error::NoRigFrames { path: from.to_owned() });
    }
    let max_time_difference_s = time_difference_s(&model, &cameras);
    let mut cameras: Vec<RigidCamera> = cameras.into_iter().map(|(camera, _)| camera).collect();
    let (error_before_px, observations_before) =
        (model.mean_reprojection_error_px(), model.num_observations());
    let length = cameras[0].right_from_left.translation.norm();
    let are_known = place.has_known_intrinsics();
    let refine = if are_known { RefineIntrinsics::NONE } else { MapperOptions::default().refine };
    let options = AdjustOptions { refine, max_iterations: ITERATIONS, ..AdjustOptions::default() };
    let options = options.weighed_against(&model);
    constrain_rigidly(&mut model, &mut cameras, &options, &FilterOptions::default())?;
    // The distance of the first two cameras is what the model's size is known by, if at all.
    let factor = length / cameras[0].right_from_left.translation.norm();
    if factor.is_normal() {
        let (rotation, translation) = (UnitQuaternion::identity(), Vector3::zeros());
        model.transform(&Sim3 { scale: factor, rotation, translation });
    }
    let images = model.frames.iter().map(|frame| frame.images.len()).sum();
    let names = std::iter::once(cameras[0].left).chain(cameras.iter().map(|camera| camera.right));
    let report = RigidReport {
        cameras: names.map(|camera| folder_of(&model, camera)).collect(),
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

/// Cameras with what mapping found of them: clocks and calibrations.
type Found = Vec<(RigSensor, Option<Rigid3>)>;

/// What mapping found of the cameras, and the images of further cameras that it found to be none of
/// their moment.
fn mounted(
    model: &Reconstruction,
    place: &ModelLocation,
) -> Result<(Found, BTreeSet<ImageId>), Error> {
    let rig = place.rig();
    let broken = |what: String| Error::Broken { path: rig.clone(), what };
    let text =
        std::fs::read(&rig).map_err(|cause| Error::Unreadable { path: rig.clone(), cause })?;
    let file = RigFile::from_json(&rig, &text)?;
    let find = |name: &str| {
        let camera = camera_of_folder(model, name);
        camera
            .map(|(id, _)| id)
            .ok_or_else(|| broken(format!("there is no camera {name} in the model")))
    };
    let left = find(&file.reference)?;
    let camera = |camera: &RigCamera| {
        let clock = &camera.clock;
        let (offset_s, drift, pivot_s) = (clock.offset_s, 1e-6 * clock.drift_ppm, clock.pivot_s);
        let rig_sensor = RigSensor {
            left,
            right: find(&camera.name)?,
            clock: Clock { offset_s, drift, pivot_s },
            clock_state: ClockState::Synchronised,
            assumed_baseline: None,
            unobservable_direction: None,
        };
        Ok((rig_sensor, Some(camera.cam_from_rig())))
    };
    let cameras = file.cameras.iter().map(camera).collect::<Result<_, Error>>()?;
    let pairs = match file.bad_pairs {
        Some(pairs) => pairs,
        None => bad_pairs_of_report(place)?,
    };
    let names: BTreeSet<&str> = pairs.iter().map(|[_, right]| right.as_str()).collect();
    let bad =
        model.images().filter(|(_, image)| names.contains(image.name.as_str())).map(|(id, _)| id);
    Ok((cameras, bad.collect()))
}

/// Workspaces of 0.1.0 before `rig.json` had the wrong pairs: there they stand in the report alone.
fn bad_pairs_of_report(place: &ModelLocation) -> Result<Vec<[String; 2]>, Error> {
    let (path, index) = place.report();
    if !path.is_file() {
        return Ok(Vec::new());
    }
    let report = Report::read(&path)?;
    let rig = report.models.get(index).and_then(|model| model.rig.as_ref());
    let extrinsics = rig.and_then(|rig| rig.extrinsics.as_ref());
    Ok(extrinsics.map_or(Vec::new(), |extrinsics| extrinsics.bad_pairs.clone()))
}

/// A camera with its moments; `None` where there are too few.
fn rigid_camera(
    model: &Reconstruction,
    rig_sensor: &RigSensor,
    calibration: Option<Rigid3>,
    bad: &BTreeSet<ImageId>,
) -> Option<RigidCamera> {
    // Together: images pair up by their clocks, whatever lies between them.
    let rig_sensor = RigSensor { clock_state: ClockState::Synchronised, ..*rig_sensor };
    let pairs: Vec<RigPair> = rig_sensor
        .referenced_images(model)
        .iter()
        .filter(|moment| !bad.contains(&moment.right))
        .map(|moment| RigPair { left: moment.nearest_left(&rig_sensor.clock), right: moment.right })
        .collect();
    let poses = relative_poses(model, &pairs);
    let (right_from_left, pairs) = match calibration {
        Some(known) => (known, pairs),
        None => {
            let all: Vec<RelativePose> = poses.iter().map(|(_, pose)| *pose).collect();
            let average = robust_average(&all)?;
            let is_near = |pose: &RelativePose| {
                let (distance, angle) = pose.apart(&average);
                distance <= MAX_DEVIATION.0 * average.translation.norm() && angle <= MAX_DEVIATION.1
            };
            (
                average.right_from_left(),
                poses.into_iter().filter(|(_, pose)| is_near(pose)).map(|(pair, _)| pair).collect(),
            )
        }
    };
    let (left, right) = (rig_sensor.left, rig_sensor.right);
    (pairs.len() >= MIN_PAIRS).then_some(RigidCamera { left, right, right_from_left, pairs })
}

fn time_difference_s(model: &Reconstruction, cameras: &[(RigidCamera, Clock)]) -> Option<f64> {
    let all = cameras
        .iter()
        .flat_map(|(camera, clock)| camera.pairs.iter().map(move |pair| (pair, clock)));
    let apart_s = |(pair, clock): (&RigPair, &Clock)| {
        let right_s = clock.reference_time_s(model.image(pair.right).time_s?);
        Some((right_s - model.image(pair.left).time_s?).abs())
    };
    all.map(apart_s).try_fold(0.0, |most: f64, apart_s| Some(most.max(apart_s?)))
}
