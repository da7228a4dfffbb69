//! One reconstruction of an experiment with its errors, which are cached beside the workspace.

use std::cell::OnceCell;
use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use tiepoint_pipeline::eval::Cloud;
use tiepoint_pipeline::eval::geometry::Sim3;
use tiepoint_pipeline::eval::geometry::nalgebra::{Quaternion, UnitQuaternion, Vector3};
use tiepoint_pipeline::io::colmap::Format;
use tiepoint_pipeline::sfm::rolling_shutter::Readout;
use tiepoint_pipeline::sfm::scene::CameraId;
use tiepoint_pipeline::sfm::{MapperOptions, RigMode};
use tiepoint_pipeline::stages::{FeatureOptions, InputModel, MapOptions, MatchOptions, map};
use tiepoint_pipeline::workspace::{RigCamera, write_model};
use tiepoint_pipeline::{Error as StageError, Options, Report, Workspace, reconstruct};
use tiepoint_synth::Drive;

use super::dense_cloud::{Comparison, DenseCloud, evaluate_dense};
use super::distance::Distance;
use super::drive::{calibration, render_once, write};
use super::scenery::Scenery;
use super::side::Side;
use crate::drive_evaluation::{DriveEvaluation, evaluate_drive};
use crate::drive_folder::{Plan, driven_m, scan};
use crate::{Error, Progress};

/// A similarity needs three camera centres or more.
pub(crate) const MIN_FRAMES: usize = 3;
/// File of the errors in the workspace.
const EVALUATION_FILE: &str = "evaluation.json";
/// Folder with the model of the true poses and intrinsics.
const TRUE_CAMERAS: &str = "true-cameras";
/// Folder in a workspace whose `sparse/0` may hold a model of COLMAP.
const COLMAP: &str = "colmap";

/// A reconstruction to make.
pub(crate) struct Task<'a> {
    /// Heading of its table row.
    pub(crate) name: &'a str,
    pub(crate) rig: RigMode,
    pub(crate) workspace: PathBuf,
    /// Workspace with the true poses and intrinsics, and the matches of `workspace`.
    pub(crate) exact: PathBuf,
    pub(crate) scenery: &'a Scenery,
    pub(crate) plan: &'a Plan,
    pub(crate) drive: &'a Drive,
}

/// A reconstruction with its errors, a row of the tables.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Run {
    /// Heading of its table row.
    pub(crate) name: String,
    pub(crate) rig: String,
    pub(crate) workspace: PathBuf,
    /// Number of rendered images.
    pub(crate) images: usize,
    /// Length of the first camera's trajectory.
    pub(crate) driven_m: f64,
    /// Why there is no result, in one sentence.
    pub(crate) failure: Option<String>,
    pub(crate) result: Option<Measurements>,
    /// COLMAP's model in the folder `colmap` of the workspace, if the user put one there.
    pub(crate) colmap: Option<Measurements>,
}

/// Errors of a model. Lengths are in metres.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Measurements {
    /// Images with a pose in the largest model.
    pub(crate) registered: usize,
    /// Number of models.
    pub(crate) models: usize,
    pub(crate) points: usize,
    /// The dense cloud beside the scan, as in the paper.
    pub(crate) dense: Option<DenseCloud>,
    /// The dense cloud of the true poses and intrinsics.
    pub(crate) exact_dense: Option<DenseCloud>,
    /// Distances of the sparse cloud to the scan.
    pub(crate) cloud: Option<Distance>,
    /// The same distances for the same tracks, triangulated with the true cameras.
    pub(crate) exact_cloud: Option<Distance>,
    /// Median distance of points seen from at most 30 m to the true surface at their pixels.
    pub(crate) surface_m: Option<f64>,
    /// Root mean square error of the camera centres.
    pub(crate) ate_m: f64,
    /// Root mean square of the horizontal component of this error.
    pub(crate) horizontal_m: f64,
    /// Root mean square of the vertical component of this error.
    pub(crate) vertical_m: f64,
    /// Mean distance of the two cameras at the instants of the second one.
    pub(crate) baseline_m: Option<f64>,
    /// Largest distance of the two cameras.
    pub(crate) largest_baseline_m: Option<f64>,
    /// Root mean square deviation of the second camera's centre from its mean, in the frame of the
    /// first camera.
    pub(crate) baseline_spread_m: Option<f64>,
    /// Baseline of the estimated rig extrinsics.
    pub(crate) extrinsics_m: Option<f64>,
    /// Wall time of all stages.
    pub(crate) seconds: f64,
    /// Scale, rotation quaternion (w first) and translation.
    pub(crate) world_from_model: [f64; 8],
}

/// The laser scan of the street, computed when it is first needed.
pub(crate) struct Scan(OnceCell<Vec<Vector3<f64>>>);

impl Scan {
    pub(crate) fn new() -> Self {
        Self(OnceCell::new())
    }

    /// The points of the scan on one side of the street; `None` if there are none.
    fn on_side(&self, drive: &Drive, side: &Side) -> Result<Option<Cloud>, Error> {
        let points = match self.0.get() {
            Some(points) => points,
            None => {
                let computed = scan(drive)?;
                self.0.get_or_init(|| computed)
            }
        };
        Ok(Cloud::new(points.par_iter().filter(|point| side.contains(point)).copied().collect()))
    }
}

impl Task<'_> {
    /// Reconstructs and evaluates on one side of the street, or reads the cached errors. A model of
    /// COLMAP is evaluated if there is one.
    pub(crate) fn run(
        &self,
        side: &Side,
        scan: &Scan,
        progress: &mut dyn Progress,
    ) -> Result<Run, Error> {
        let run = self.reconstruct_and_evaluate(side, scan, progress)?;
        let folder = self.workspace.join(COLMAP);
        if !folder.join("sparse/0").is_dir() {
            return Ok(run);
        }
        let path = folder.join(EVALUATION_FILE);
        let kept = fs::read(&path).ok().and_then(|text| serde_json::from_slice(&text).ok());
        let measured = match kept {
            Some(kept) => kept,
            None => {
                let scan = scan.on_side(self.drive, side)?;
                let evaluation = self.evaluate_drive(&folder, side, scan.as_ref())?;
                let measured = Measurements::new(None, evaluation);
                write(&path, &json(&measured))?;
                measured
            }
        };
        Ok(Run { colmap: Some(measured), ..run })
    }

    fn reconstruct_and_evaluate(
        &self,
        side: &Side,
        scan: &Scan,
        progress: &mut dyn Progress,
    ) -> Result<Run, Error> {
        let path = self.workspace.join(EVALUATION_FILE);
        // A folder has one set of options, so that cached errors are valid.
        let kept = fs::read(&path).ok().and_then(|text| serde_json::from_slice::<Run>(&text).ok());
        if let Some(kept) = kept {
            return Ok(Run { workspace: self.workspace.clone(), colmap: None, ..kept });
        }
        render_once(self.plan, self.drive, progress)?;
        let images = self.drive.cameras().iter().map(|camera| camera.exposures.len()).sum();
        let run = Run {
            name: self.name.to_owned(),
            rig: self.rig.name().to_owned(),
            workspace: self.workspace.clone(),
            images,
            driven_m: driven_m(self.drive),
            failure: None,
            result: None,
            colmap: None,
        };
        let report = self.reconstruct(progress);
        let scan = if report.is_ok() { scan.on_side(self.drive, side)? } else { None };
        let run = match report.and_then(|report| {
            Ok((report, self.evaluate_drive(&self.workspace, side, scan.as_ref())?))
        }) {
            Ok((report, evaluation)) => {
                let [dense, exact_dense] =
                    self.dense_clouds(&evaluation, side, scan.as_ref(), progress)?;
                let measured = Measurements::new(Some(&report), evaluation);
                Run { result: Some(Measurements { dense, exact_dense, ..measured }), ..run }
            }
            // These errors are results of the experiment: the images do not suffice.
            Err(
                error @ (StageError::NoOverlap { .. }
                | StageError::Evaluation { .. }
                | StageError::NoSynchronousImages { .. }),
            ) => Run { failure: Some(error.to_string()), ..run },
            Err(error) => return Err(error.into()),
        };
        write(&path, &json(&run))?;
        Ok(run)
    }

    fn evaluate_drive(
        &self,
        model: &Path,
        side: &Side,
        scan: Option<&Cloud>,
    ) -> Result<DriveEvaluation, StageError> {
        evaluate_drive(model, self.drive, &self.plan.truth(), scan, |point| side.contains(point))
    }

    /// The dense clouds of the workspace and of the true poses and intrinsics.
    fn dense_clouds(
        &self,
        evaluation: &DriveEvaluation,
        side: &Side,
        scan: Option<&Cloud>,
        progress: &mut dyn Progress,
    ) -> Result<[Option<DenseCloud>; 2], Error> {
        let Some(scan) = scan.filter(|_| self.scenery.has_dense_clouds) else {
            return Ok([None, None]);
        };
        let mut comparison = Comparison {
            scan,
            world_from_model: evaluation.poses.truth_from_model,
            cameras: &evaluation.camera_errors,
            has_true_poses: false,
            is_compared: &|point| side.contains(point),
        };
        let estimated = evaluate_dense(&self.workspace, &comparison, progress)?;
        match self.reconstruct_exact(progress) {
            Ok(()) => {}
            // The matches do not fit the true poses, because the images of a rolling shutter or of
            // few frames leave too few points.
            Err(StageError::Mapping(_) | StageError::InputModel { .. }) => {
                return Ok([estimated, None]);
            }
            Err(error) => return Err(error.into()),
        }
        comparison.world_from_model = Sim3::identity();
        comparison.has_true_poses = true;
        Ok([estimated, evaluate_dense(&self.exact, &comparison, progress)?])
    }

    /// Triangulates the matches with the true poses and intrinsics, which are kept.
    fn reconstruct_exact(&self, progress: &mut dyn Progress) -> Result<(), StageError> {
        Workspace::open(&self.workspace)?.fork(&self.exact)?;
        let folder = self.exact.with_file_name(TRUE_CAMERAS);
        let mut truth = self.drive.truth();
        let cameras: Vec<CameraId> = truth.cameras().map(|(id, _)| id).collect();
        for (id, camera) in cameras.into_iter().zip(self.drive.cameras()) {
            let (width, height) = (camera.width, camera.height);
            truth.camera_mut(id).intrinsics = camera.lens.nearest_intrinsics(width, height);
        }
        write_model(&folder, &truth, Format::Binary)?;
        let truth = InputModel { path: folder, fix_existing_frames: true };
        let seed = self.scenery.seed;
        let options = MapOptions {
            mapper: MapperOptions { rig: RigMode::Off, seed, ..MapperOptions::default() },
            input_model: Some(truth),
            ..MapOptions::default()
        };
        let mut exact = Workspace::open(&self.exact)?;
        map(&mut exact, &options, None, &mut |event| progress.watch(event))
    }

    fn reconstruct(&self, progress: &mut dyn Progress) -> Result<Report, StageError> {
        let Scenery { pairs, seed, effects, .. } = self.scenery;
        // As with real cameras, the kind of shutter is known and the readout time is not.
        let readout = (effects.readout_s > 0.0).then_some(Readout::Estimated);
        let options = Options {
            features: FeatureOptions {
                calibration: calibration(self.scenery, self.drive),
                timestamps: Some(self.plan.folder.join("timestamps.csv")),
                ..FeatureOptions::default()
            },
            matching: MatchOptions { pairs: *pairs, seed: *seed, ..MatchOptions::default() },
            mapping: MapOptions {
                mapper: MapperOptions {
                    rig: self.rig,
                    readout,
                    seed: *seed,
                    ..MapperOptions::default()
                },
                ..MapOptions::default()
            },
            ..Options::default()
        };
        let input = std::slice::from_ref(&self.plan.folder);
        reconstruct(input, &self.workspace, &options, &mut |event| progress.watch(event))
    }
}

fn json(value: &impl Serialize) -> String {
    serde_json::to_string_pretty(value).expect("our own types are JSON: string keys")
}

impl Measurements {
    fn new(report: Option<&Report>, evaluation: DriveEvaluation) -> Self {
        let DriveEvaluation {
            poses,
            model,
            camera_errors,
            baseline,
            surface,
            cloud,
            exact_cloud,
            ..
        } = evaluation;
        let rms = |squares: &dyn Fn(&Vector3<f64>) -> f64| {
            let sum: f64 =
                camera_errors.iter().map(|e| squares(&(e.estimated_centre - e.true_centre))).sum();
            (sum / camera_errors.len().max(1) as f64).sqrt()
        };
        let seconds = report.map(|Report { stages, .. }| {
            [
                stages.features.as_ref().map(|stage| stage.seconds),
                stages.matches.as_ref().map(|stage| stage.seconds),
                stages.map.as_ref().map(|stage| stage.seconds),
            ]
        });
        let Sim3 { scale, rotation: r, translation: t } = poses.truth_from_model;
        let extrinsics = report.and_then(|report| report.models.first()).and_then(|model| {
            model.rig.as_ref()?.extrinsics.as_ref()?.rig.as_ref()?.cameras.first()
        });
        let length = |camera: &RigCamera| scale * Vector3::from(camera.translation).norm();
        Self {
            registered: poses.registered,
            models: report.map_or(1, |report| report.models.len()),
            points: model.num_tracks(),
            dense: None,
            exact_dense: None,
            cloud: cloud.as_ref().map(Distance::from),
            exact_cloud: exact_cloud.as_ref().map(Distance::from),
            surface_m: surface.and_then(|surface| Some(surface.near?.median)),
            ate_m: poses.centre_error.rmse,
            horizontal_m: rms(&|off| off.xy().norm_squared()),
            vertical_m: rms(&|off| off.z.powi(2)),
            baseline_m: baseline.map(|baseline| baseline.mean_m),
            largest_baseline_m: baseline.map(|baseline| baseline.max_m),
            baseline_spread_m: baseline.map(|baseline| baseline.deviation_m),
            extrinsics_m: extrinsics.map(length),
            seconds: seconds.iter().flatten().flatten().sum(),
            world_from_model: [scale, r.w, r.i, r.j, r.k, t.x, t.y, t.z],
        }
    }
}

impl Run {
    /// The alignment of our model to the ground truth.
    pub(crate) fn world_from_model(&self) -> Option<Sim3> {
        let [scale, w, x, y, z, tx, ty, tz] = self.result.as_ref()?.world_from_model;
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
        Some(Sim3 { scale, rotation, translation: Vector3::new(tx, ty, tz) })
    }
}
