use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tiepoint_input::SkippedImage;
use tiepoint_sfm::MappedModel;
use tiepoint_sfm::scene::{Camera, CameraId};
use tiepoint_store::{Error as StoreError, require_regular_file};

use crate::workspace::control_report::ControlReport;
use crate::workspace::file_names::DENSE_CLOUD;
use crate::workspace::format::finite;
use crate::workspace::overlay_report::OverlayReport;
use crate::workspace::rig_report::RigReport;
use crate::workspace::unregistered::UnregisteredImage;
use crate::workspace::warning::Warning;
use crate::{Error, Stage};

/// `report.json`: the results of all stages.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct Report {
    /// Version of this program.
    pub version: String,
    /// Summaries of the stages.
    pub stages: StageReports,
    /// The models, the largest first.
    pub models: Vec<ModelReport>,
    /// Signs that something is wrong.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<Warning>,
}

/// Summaries of the stages; `None` before a stage is complete.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct StageReports {
    /// Stage 1.
    pub features: Option<FeaturesReport>,
    /// Stage 2. The key of the file is `match`.
    #[serde(rename = "match")]
    pub matches: Option<MatchReport>,
    /// Stage 3.
    pub map: Option<MapReport>,
    /// Stage 4.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dense: Option<DenseReport>,
}

/// Summary of feature extraction.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct FeaturesReport {
    /// Wall time of the run that completed the stage.
    pub seconds: f64,
    /// Number of images with features.
    pub images: usize,
    /// Number of keypoints of all images.
    pub keypoints: usize,
    /// Images that were skipped.
    pub skipped: Vec<SkippedImage>,
    /// What was noted about the input, a sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Initial cameras.
    pub cameras: Vec<CameraReport>,
}

impl FeaturesReport {
    /// Number of files that were skipped: an entry may stand for several.
    pub fn num_skipped(&self) -> usize {
        self.skipped.iter().map(|image| 1 + image.others).sum()
    }
}

/// Summary of matching.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct MatchReport {
    /// Wall time of the run that completed the stage.
    pub seconds: f64,
    /// The time that this run expected before it began.
    #[serde(default)]
    pub expected_seconds: f64,
    /// The selection of pairs in the words of the command line; for `auto` what it chose.
    #[serde(default)]
    pub selection: String,
    /// Number of image pairs that were matched.
    pub pairs: usize,
    /// Number of pairs with a verified two-view geometry.
    pub verified_pairs: usize,
    /// Number of descriptor matches.
    pub matches: usize,
    /// Number of inlier matches of verified pairs.
    pub inlier_matches: usize,
    /// Number of matches on overlays, which are not used.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub stationary_matches: usize,
    /// Number of pairs that have nothing but matches on overlays.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub watermark_pairs: usize,
    /// What stands still in images while the scene moves.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub overlays: Vec<OverlayReport>,
}

impl MatchReport {
    /// What a user should know about the matches.
    pub(crate) fn warnings(&self) -> Vec<Warning> {
        let found = (self.stationary_matches > 0).then(|| Warning::StationaryMatches {
            matches: self.stationary_matches,
            watermark_pairs: self.watermark_pairs,
            overlays: self.overlays.clone(),
        });
        found.into_iter().collect()
    }
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// Summary of mapping.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct MapReport {
    /// Wall time.
    pub seconds: f64,
    /// What was noted about the photos, a sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// The images without a pose in the largest model.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unregistered: Vec<UnregisteredImage>,
}

/// Summary of dense reconstruction.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct DenseReport {
    /// Wall time of the run that completed the stage.
    pub seconds: f64,
    /// Number of images with a depth map.
    pub depth_maps: usize,
    /// Number of those of a rolling shutter whose motion during the readout is known: the depth of
    /// a pixel is z in the pose of its row.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub depth_maps_with_row_poses: usize,
    /// Registered images without a depth map, since they share no points with another image.
    pub without_depth_map: Vec<String>,
    /// Number of pixels of all depth maps, in millions.
    pub megapixels: f64,
    /// Number of points of the cloud.
    pub points: u64,
}

/// A model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct ModelReport {
    /// Its folder, relative to the workspace.
    pub path: String,
    /// Number of registered images.
    pub registered: usize,
    /// Number of images with features.
    pub images: usize,
    /// Names of the unregistered images.
    pub unregistered: Vec<String>,
    /// Number of points.
    pub points: usize,
    /// Number of observations.
    pub observations: usize,
    /// Mean number of observations per point.
    pub mean_track_length: f64,
    /// Mean over the points of the mean reprojection error of their observations, in pixels, as in
    /// COLMAP.
    pub mean_reprojection_error_px: f64,
    /// Cameras with a registered image.
    pub cameras: Vec<CameraReport>,
    /// The rig, if there are cameras with synchronous images.
    pub rig: Option<RigReport>,
    /// Number of image pairs that drift had separated and that loop closure merged.
    #[serde(default)]
    pub loop_pairs: usize,
    /// Images of another place that looks like the one of this model: matches put both on one
    /// place.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub other_place: Vec<String>,
    /// Optional stages that failed, as sentences; the model is that without them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub failed: Vec<String>,
    /// The metric scale, with `--baseline`.
    pub scale: Option<ScaleReport>,
    /// How the model lies to measured positions, if it is in their frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub positions: Option<PositionReport>,
    /// The control points and check points, if the model was adjusted together with them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub control_points: Option<ControlReport>,
}

/// A camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct CameraReport {
    /// COLMAP's id.
    pub id: u32,
    /// COLMAP's name of the camera model.
    pub model: String,
    /// Image width, in pixels.
    pub width: u32,
    /// Image height, in pixels.
    pub height: u32,
    /// Parameters of the camera model, in COLMAP's order.
    pub params: Vec<f64>,
    /// Standard deviations of the parameters; 0 for constant ones. A principal point that was held
    /// because no camera turns has that of a free one with its prior. Empty if none was refined or
    /// the images do not determine them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub params_sd: Vec<f64>,
    /// The calibration that was given, and how far it was refined.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationReport>,
    /// With `--rolling-shutter`: readout time from the first row to the last, in seconds.
    #[serde(default)]
    pub readout_s: Option<f64>,
    /// Its standard deviation, if it was estimated and is observable.
    #[serde(default)]
    pub readout_sd_s: Option<f64>,
}

/// A calibration of a camera that was refined. Parameters are in COLMAP's order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct CalibrationReport {
    /// The calibrated parameters.
    pub params: Vec<f64>,
    /// Their standard deviations. `None` for parameters without influence on pixels.
    pub sigmas: Vec<Option<f64>>,
    /// By how many standard deviations the refined parameters differ.
    pub deviations: Vec<f64>,
    /// Whether the calibration was kept, because the images do not contradict it.
    #[serde(default)]
    pub is_exact: bool,
    /// Logarithm of the Bayes factor against exact calibrations of the model's cameras. `None` if
    /// the images are too few to tell, or the deviations were stated.
    #[serde(default)]
    pub log_bayes_factor: Option<f64>,
}

impl CalibrationReport {
    /// Of a camera of a model; `None` if it has none, or one of another camera model.
    fn of_model(id: CameraId, mapped: &MappedModel) -> Option<Self> {
        let model = &mapped.reconstruction;
        let (prior, refined) = (model.intrinsics_priors.get(&id)?, &model.camera(id).intrinsics);
        (prior.mean.kind() == refined.kind()).then(|| Self {
            params: prior.mean.params().to_vec(),
            sigmas: finite(&prior.sigmas),
            deviations: prior.deviations(refined),
            is_exact: model.calibrated.contains(&id),
            log_bayes_factor: mapped.calibration_evidence.get(&id).copied(),
        })
    }
}

impl CameraReport {
    /// The report on a camera before mapping.
    pub(crate) fn new(id: CameraId, camera: &Camera) -> Self {
        let (model, params) =
            (camera.intrinsics.kind().name().to_owned(), camera.intrinsics.params().to_vec());
        let (width, height) = (camera.width, camera.height);
        let (params_sd, calibration, readout_s, readout_sd_s) = (Vec::new(), None, None, None);
        Self {
            id: id.0 + 1,
            model,
            width,
            height,
            params,
            params_sd,
            calibration,
            readout_s,
            readout_sd_s,
        }
    }

    /// The report on a camera of a model.
    fn of_model(id: CameraId, mapped: &MappedModel) -> Self {
        let MappedModel { reconstruction: model, intrinsics_sds, shutters, .. } = mapped;
        let shutter = shutters.iter().find(|shutter| shutter.camera == id);
        let params_sd = intrinsics_sds.get(&id).cloned().unwrap_or_default();
        let camera = model.camera(id);
        let calibration = CalibrationReport::of_model(id, mapped);
        let readout_s = shutter.map(|shutter| shutter.readout_s);
        let readout_sd_s =
            shutter.and_then(|shutter| shutter.readout_sd_s).filter(|sd_s| sd_s.is_finite());
        Self { params_sd, calibration, readout_s, readout_sd_s, ..Self::new(id, camera) }
    }
}
impl ModelReport {
    /// The report on a model and its cameras, without rig and scale.
    pub(crate) fn new(path: String, mapped: &MappedModel) -> Self {
        let model = &mapped.reconstruction;
        // Images without keypoints could not be read.
        let images = || model.images().filter(|(_, image)| !image.keypoints.is_empty());
        let unregistered = images().filter(|(_, image)| image.cam_from_world().is_none());
        Self {
            path,
            registered: model.num_registered(),
            images: images().count(),
            unregistered: unregistered.map(|(_, image)| image.name.clone()).collect(),
            points: model.num_tracks(),
            observations: model.num_observations(),
            mean_track_length: model.mean_track_length(),
            mean_reprojection_error_px: model.mean_reprojection_error_px(),
            cameras: model
                .registered_cameras()
                .into_iter()
                .map(|id| CameraReport::of_model(id, mapped))
                .collect(),
            rig: None,
            loop_pairs: 0,
            other_place: Vec::new(),
            failed: Vec::new(),
            scale: None,
            positions: None,
            control_points: None,
        }
    }
}

impl Report {
    /// The file of the dense cloud of the current model. That of an earlier model stays on disk,
    /// and the report has none; files of the stage may have been deleted.
    pub fn dense_cloud(&self, workspace: &Path) -> Option<PathBuf> {
        let path = workspace.join(DENSE_CLOUD);
        (self.stages.dense.is_some() && path.is_file()).then_some(path)
    }

    /// Reads `report.json`; an empty report if the file does not exist.
    ///
    /// # Errors
    ///
    /// The file cannot be read or is damaged.
    pub fn read(path: &Path) -> Result<Self, Error> {
        require_regular_file(path)?;
        match std::fs::read(path) {
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => {
                Ok(Self { version: env!("CARGO_PKG_VERSION").to_owned(), ..Self::default() })
            }
            Err(cause) => Err(StoreError::Unreadable { path: path.to_owned(), cause }.into()),
            Ok(text) => serde_json::from_slice(&text)
                .map_err(|error| Error::Broken { path: path.to_owned(), what: error.to_string() }),
        }
    }

    /// Removes the parts on stages that are not complete.
    pub(crate) fn keep_only(&mut self, is_complete: impl Fn(Stage) -> bool) {
        let Self { stages, models, warnings, .. } = self;
        for stage in Stage::ALL.into_iter().filter(|stage| !is_complete(*stage)) {
            match stage {
                Stage::Features => stages.features = None,
                Stage::Match => {
                    stages.matches = None;
                    warnings.clear();
                }
                Stage::Map => {
                    stages.map = None;
                    models.clear();
                    warnings.retain(Warning::is_of_matches);
                }
                Stage::Dense => stages.dense = None,
            }
        }
    }
}

/// How a model lies to measured positions. Where on the earth it is, is not here.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct PositionReport {
    /// Number of images with a pose and a position.
    pub positions: usize,
    /// Images whose positions deviate by more than three deviations.
    pub outliers: Vec<String>,
    /// Standard deviation of the positions about the model along a horizontal axis, in metres.
    pub sigma_horizontal_m: f64,
    /// Standard deviation of their heights, in metres; `None` if too few have one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_vertical_m: Option<f64>,
    /// What gives the scale: `positions`, `baseline` or `rig`.
    pub scale_of: String,
    /// The scale that the positions give, relative to that of the model. `None` if they do not tell
    /// it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// Its standard deviation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale_sd: Option<f64>,
    /// Standard deviation of the heading, in degrees.
    pub heading_sd_deg: f64,
    /// Standard deviation of the vertical, in degrees, if the photos being level gives it: the
    /// positions are on a line or have no altitudes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub level_sd_deg: Option<f64>,
    /// Whether the positions took part in the adjustments.
    pub is_adjusted: bool,
    /// Median distance of the cameras from held-out positions, in metres: without positions in the
    /// adjustments, and with the others. `None` if that was not tried.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_out_median_m: Option<[f64; 2]>,
    /// By how many of its standard deviations the squared distance is smaller with them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_out_t: Option<f64>,
    /// The clock of positions with times of their own, and where their antenna is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clock: Option<ClockReport>,
}

/// How positions with times of their own lie to the photos of one body.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct ClockReport {
    /// Time on the clock of the positions minus that on the clock of the photos, in seconds.
    pub offset_s: f64,
    /// Its standard deviation.
    pub offset_sd_s: f64,
    /// The antenna in the axes of the camera, in metres.
    pub arm_m: [f64; 3],
    /// Its standard deviations, in metres; 1 where the motion tells nothing, an assumption.
    pub arm_sds_m: [f64; 3],
}

/// The metric scale of a model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct ScaleReport {
    /// The given distance of the first two cameras, in metres.
    pub baseline_m: f64,
    /// Metres per unit of the model before scaling. `None` if the model was not scaled.
    pub factor: Option<f64>,
    /// The source of the factor, or why there is none, in one sentence.
    pub reason: String,
}
