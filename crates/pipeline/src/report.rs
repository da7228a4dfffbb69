use std::path::Path;

use serde::{Deserialize, Serialize};
use tiepoint_sfm::RollingShutter;
use tiepoint_sfm::scene::{Camera, CameraId, Reconstruction};

use crate::{Error, RigReport, ScaleReport, Stage};

/// `report.json`: what came out of each stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Version of this program.
    pub version: String,
    /// What each stage did.
    pub stages: StageReports,
    /// The models, the largest first.
    pub models: Vec<ModelReport>,
}

/// What each stage did; `None` before it is complete.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageReports {
    /// Keypoints and descriptors.
    pub features: Option<FeaturesReport>,
    /// Matches.
    #[serde(rename = "match")]
    pub matches: Option<MatchReport>,
    /// The mapper.
    pub map: Option<MapReport>,
}

/// What the extraction of features gave.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FeaturesReport {
    /// Wall time of the run that ended it.
    pub seconds: f64,
    /// Images with features.
    pub images: usize,
    /// Keypoints of all.
    pub keypoints: usize,
    /// Images that could not be used.
    pub skipped: Vec<SkippedImage>,
    /// As they were before any image was registered.
    pub cameras: Vec<CameraReport>,
}

/// An image that could not be used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SkippedImage {
    /// Its name.
    pub image: String,
    /// Why.
    pub why: String,
}

/// What matching gave.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MatchReport {
    /// Wall time of the run that ended it.
    pub seconds: f64,
    /// Pairs of images that were matched.
    pub pairs: usize,
    /// Those with a two-view geometry.
    pub verified_pairs: usize,
    /// Matches of descriptors.
    pub matches: usize,
    /// Those that agree with a two-view geometry.
    pub inlier_matches: usize,
}

/// What the mapper did.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MapReport {
    /// Wall time.
    pub seconds: f64,
}

/// A model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ModelReport {
    /// Its folder, relative to the workspace.
    pub path: String,
    /// Images with a pose.
    pub registered: usize,
    /// Images with features.
    pub images: usize,
    /// Names of the images without a pose.
    pub unregistered: Vec<String>,
    /// Points.
    pub points: usize,
    /// Observations of them.
    pub observations: usize,
    /// Observations a point.
    pub mean_track_length: f64,
    /// Mean over the points of the mean over their observations, in pixels, as COLMAP has it.
    pub mean_reprojection_error_px: f64,
    /// Cameras with an image in it.
    pub cameras: Vec<CameraReport>,
    /// Cameras that took images at the same moments.
    pub rig: Option<RigReport>,
    /// Pairs of images that drift had torn apart where the way meets itself, and that are one place
    /// now.
    #[serde(default)]
    pub loop_pairs: usize,
    /// What was asked for and failed, as sentences; the model is as it would be without.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub failed: Vec<String>,
    /// What a given distance of two cameras made of it.
    pub scale: Option<ScaleReport>,
}

/// A camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraReport {
    /// COLMAP's id.
    pub id: u32,
    /// COLMAP's name of the model.
    pub model: String,
    /// In pixels.
    pub width: u32,
    /// In pixels.
    pub height: u32,
    /// Parameters of the model, in its order.
    pub params: Vec<f64>,
    /// With `--rolling-shutter`: time from the first row to the last one, in seconds.
    #[serde(default)]
    pub readout_s: Option<f64>,
    /// Its standard deviation, where it was estimated and the images tell it.
    #[serde(default)]
    pub readout_sd_s: Option<f64>,
}

impl CameraReport {
    pub(crate) fn new(id: CameraId, camera: &Camera, shutter: Option<&RollingShutter>) -> Self {
        let (model, params) =
            (camera.intrinsics.kind().name().to_owned(), camera.intrinsics.params().to_vec());
        let readout_s = shutter.map(|shutter| shutter.readout_s);
        let readout_sd_s =
            shutter.and_then(|shutter| shutter.readout_sd_s).filter(|sd_s| sd_s.is_finite());
        let (width, height) = (camera.width, camera.height);
        Self { id: id.0 + 1, model, width, height, params, readout_s, readout_sd_s }
    }
}

impl ModelReport {
    /// What the model itself tells, and the shutters of its cameras.
    pub(crate) fn new(path: String, model: &Reconstruction, shutters: &[RollingShutter]) -> Self {
        // Images without keypoints could not be read.
        let images = || model.images().filter(|(_, image)| !image.keypoints.is_empty());
        let unregistered = images().filter(|(_, image)| image.cam_from_world().is_none());
        let is_used = |id: &CameraId| model.registered().any(|(_, image, _)| image.camera == *id);
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
                .cameras()
                .filter(|(id, _)| is_used(id))
                .map(|(id, c)| {
                    CameraReport::new(id, c, shutters.iter().find(|shutter| shutter.camera == id))
                })
                .collect(),
            rig: None,
            loop_pairs: 0,
            failed: Vec::new(),
            scale: None,
        }
    }
}

impl Report {
    pub(crate) fn read(path: &Path) -> Result<Self, Error> {
        match std::fs::read(path) {
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => {
                Ok(Self { version: env!("CARGO_PKG_VERSION").to_owned(), ..Self::default() })
            }
            Err(cause) => Err(Error::Unreadable { path: path.to_owned(), cause }),
            Ok(text) => serde_json::from_slice(&text)
                .map_err(|error| Error::Broken { path: path.to_owned(), what: error.to_string() }),
        }
    }

    /// Drops what is said of stages that are not there.
    pub(crate) fn keep_only(&mut self, is_there: impl Fn(Stage) -> bool) {
        let Self { stages, models, .. } = self;
        if !is_there(Stage::Features) {
            stages.features = None;
        }
        if !is_there(Stage::Match) {
            stages.matches = None;
        }
        if !is_there(Stage::Map) {
            stages.map = None;
            models.clear();
        }
    }
}
