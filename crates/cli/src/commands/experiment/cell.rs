//! One reconstruction of an experiment against the truth: made once, kept as numbers.

use std::cell::OnceCell;
use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use tiepoint_pipeline::eval::geometry::Sim3;
use tiepoint_pipeline::eval::geometry::nalgebra::{Quaternion, UnitQuaternion, Vector3};
use tiepoint_pipeline::sfm::{MapperOptions, Readout, RigTerm};
use tiepoint_pipeline::{
    CloudEvaluation, Error, FeatureOptions, MapOptions, MatchOptions, Options, Report, RigCamera,
    reconstruct,
};
use tiepoint_synth::Drive;

use super::drive::{calibration, rendered, write};
use super::side::Side;
use crate::args::{Scenery, rig_name};
use crate::commands::judge::{Judged, judge};
use crate::commands::synth::{Plan, driven_m, scan};
use crate::failure::Failure;
use crate::progress::Progress;

/// A trajectory is aligned to the truth by three places or more.
pub(super) const MIN_FRAMES: usize = 3;
/// Kept beside the workspace's own files.
const JUDGED: &str = "judged.json";
/// Where COLMAP's model may lie in a workspace, as `sparse/0`.
const COLMAP: &str = "colmap";

/// A reconstruction to make.
pub(super) struct Task<'a> {
    /// The name of its row.
    pub(super) name: &'a str,
    pub(super) rig: RigTerm,
    pub(super) workspace: PathBuf,
    pub(super) scenery: &'a Scenery,
    pub(super) plan: &'a Plan,
    pub(super) drive: &'a Drive,
}

/// What came out. Lengths are in metres.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Cell {
    /// The name of its row.
    pub(super) name: String,
    pub(super) rig: String,
    pub(super) workspace: PathBuf,
    /// Images rendered, and how far the first camera drove from its first to its last.
    pub(super) images: usize,
    pub(super) driven_m: f64,
    /// Why there is no result, in one sentence.
    pub(super) failure: Option<String>,
    pub(super) result: Option<Measured>,
    /// COLMAP's model of the same matches, where somebody put one into the folder `colmap` of the
    /// workspace.
    pub(super) colmap: Option<Measured>,
}

/// A model against the truth.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Measured {
    /// Images with a pose in the largest model.
    pub(super) registered: usize,
    /// Models that the images fell apart into.
    pub(super) models: usize,
    pub(super) points: usize,
    /// Distance of the cloud to the scan: the paper's numbers.
    pub(super) cloud: Option<Distance>,
    /// The same of the same tracks, had the cameras been exactly known.
    pub(super) exact_cloud: Option<Distance>,
    /// Median distance of points seen from up to 30 m to the surface that their pixels show.
    pub(super) surface_m: Option<f64>,
    /// Root mean square error of the camera centres, whole, and its parts.
    pub(super) ate_m: f64,
    pub(super) horizontal_m: f64,
    pub(super) vertical_m: f64,
    /// Distance of two cameras over all moments: mean, largest, and the root mean square deviation
    /// of the second camera's place.
    pub(super) baseline_m: Option<f64>,
    pub(super) largest_baseline_m: Option<f64>,
    pub(super) baseline_spread_m: Option<f64>,
    /// Length of the mounting that was found.
    pub(super) mounting_m: Option<f64>,
    /// Of the stages, whenever they ran.
    pub(super) seconds: f64,
    /// Scale, rotation (w first) and translation of the model in the world.
    pub(super) world_from_model: [f64; 8],
}

/// Mean absolute distance and standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Distance {
    pub(super) mean_m: f64,
    pub(super) std_m: f64,
}

impl From<CloudEvaluation> for Distance {
    fn from(cloud: CloudEvaluation) -> Self {
        Self { mean_m: cloud.distance.mean, std_m: cloud.distance.std }
    }
}

/// What a laser scanner sees of the street: the same for all cells, and made for the first that
/// needs it.
pub(super) struct Scan(OnceCell<Vec<Vector3<f64>>>);

impl Scan {
    pub(super) fn new() -> Self {
        Self(OnceCell::new())
    }

    fn beside(&self, drive: &Drive, side: &Side) -> Result<Vec<Vector3<f64>>, Failure> {
        let whole = match self.0.get() {
            Some(whole) => whole,
            None => {
                let made = scan(drive)?;
                self.0.get_or_init(|| made)
            }
        };
        Ok(whole.par_iter().filter(|point| side.has(point)).copied().collect())
    }
}

impl Task<'_> {
    /// The result of an earlier run, or a new one, of what is on one side of the way.
    pub(super) fn run(
        &self,
        side: &Side,
        scan: &Scan,
        progress: &mut Progress,
    ) -> Result<Cell, Failure> {
        let cell = self.own(side, scan, progress)?;
        let folder = self.workspace.join(COLMAP);
        if !folder.join("sparse/0").is_dir() {
            return Ok(cell);
        }
        let path = folder.join(JUDGED);
        let kept = fs::read(&path).ok().and_then(|text| serde_json::from_slice(&text).ok());
        let measured = match kept {
            Some(kept) => kept,
            None => {
                let measured = Measured::new(None, self.judge(&folder, side, scan)??);
                write(&path, &json(&measured))?;
                measured
            }
        };
        Ok(Cell { colmap: Some(measured), ..cell })
    }

    fn own(&self, side: &Side, scan: &Scan, progress: &mut Progress) -> Result<Cell, Failure> {
        let path = self.workspace.join(JUDGED);
        // The folder is of one set of options, so what is there is of these.
        let kept = fs::read(&path).ok().and_then(|text| serde_json::from_slice::<Cell>(&text).ok());
        if let Some(kept) = kept {
            return Ok(Cell { workspace: self.workspace.clone(), colmap: None, ..kept });
        }
        rendered(self.plan, self.drive, progress)?;
        let images = self.drive.cameras().iter().map(|camera| camera.exposures.len()).sum();
        let cell = Cell {
            name: self.name.to_owned(),
            rig: rig_name(self.rig).to_owned(),
            workspace: self.workspace.clone(),
            images,
            driven_m: driven_m(self.drive),
            failure: None,
            result: None,
            colmap: None,
        };
        let report = self.reconstruct(progress);
        let cell = match report
            .and_then(|report| Ok((report, self.judge(&self.workspace, side, scan)?)))
        {
            Ok((report, judged)) => {
                Cell { result: Some(Measured::new(Some(&report), judged?)), ..cell }
            }
            // Too few common views, or none that tell a scale, are a result too.
            Err(
                error @ (Error::NoOverlap { .. }
                | Error::Evaluation { .. }
                | Error::NoMoments { .. }),
            ) => Cell { failure: Some(error.to_string()), ..cell },
            Err(error) => return Err(error.into()),
        };
        write(&path, &json(&cell))?;
        Ok(cell)
    }

    /// The outer error may be an outcome, the inner one is none.
    fn judge(
        &self,
        model: &Path,
        side: &Side,
        scan: &Scan,
    ) -> Result<Result<Judged, Failure>, Error> {
        let reference = match scan.beside(self.drive, side) {
            Ok(reference) => reference,
            Err(failure) => return Ok(Err(failure)),
        };
        let truth = self.plan.truth();
        judge(model, self.drive, &truth, &reference, |point| side.has(point)).map(Ok)
    }

    fn reconstruct(&self, progress: &mut Progress) -> Result<Report, Error> {
        let Scenery { pairs, seed, effects, .. } = self.scenery;
        // That a sensor is read row by row is known of a camera, and how fast is not.
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
                baseline_m: None,
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

impl Measured {
    fn new(report: Option<&Report>, judged: Judged) -> Self {
        let Judged { poses, model, whereabouts, baseline, surface, cloud, exact_cloud, .. } =
            judged;
        let rms = |squares: &dyn Fn(&Vector3<f64>) -> f64| {
            let sum: f64 =
                whereabouts.iter().map(|place| squares(&(place.found - place.truth))).sum();
            (sum / whereabouts.len().max(1) as f64).sqrt()
        };
        let seconds = report.map(|Report { stages, .. }| {
            [
                stages.features.as_ref().map(|stage| stage.seconds),
                stages.matches.as_ref().map(|stage| stage.seconds),
                stages.map.as_ref().map(|stage| stage.seconds),
            ]
        });
        let Sim3 { scale, rotation: r, translation: t } = poses.truth_from_model;
        let mounting = report
            .and_then(|report| report.models.first())
            .and_then(|model| model.rig.as_ref()?.mounting.as_ref()?.rig.as_ref()?.cameras.first());
        let length = |camera: &RigCamera| scale * Vector3::from(camera.translation).norm();
        Self {
            registered: poses.registered,
            models: report.map_or(1, |report| report.models.len()),
            points: model.num_tracks(),
            cloud: cloud.map(Distance::from),
            exact_cloud: exact_cloud.map(Distance::from),
            surface_m: surface.and_then(|surface| Some(surface.near?.median)),
            ate_m: poses.centre_error.rmse,
            horizontal_m: rms(&|off| off.xy().norm_squared()),
            vertical_m: rms(&|off| off.z.powi(2)),
            baseline_m: baseline.as_ref().map(|baseline| baseline.baseline.mean),
            largest_baseline_m: baseline.as_ref().map(|baseline| baseline.baseline.max),
            baseline_spread_m: baseline.as_ref().map(|baseline| baseline.translation_rms),
            mounting_m: mounting.map(length),
            seconds: seconds.iter().flatten().flatten().sum(),
            world_from_model: [scale, r.w, r.i, r.j, r.k, t.x, t.y, t.z],
        }
    }
}

impl Cell {
    pub(super) fn world_from_model(&self) -> Option<Sim3> {
        let [scale, w, x, y, z, tx, ty, tz] = self.result.as_ref()?.world_from_model;
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
        Some(Sim3 { scale, rotation, translation: Vector3::new(tx, ty, tz) })
    }
}
