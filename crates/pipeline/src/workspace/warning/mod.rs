//! What a user should know about a finished run, from the model itself.
//!
//! Each warning is data; its text is one sentence: what was found, and what to do. A model that
//! earns none may still be wrong, but is not known to be.

mod sentences;

use serde::{Deserialize, Serialize};

use crate::workspace::overlay_report::OverlayReport;

/// A sign that something is wrong. Images are named; cameras have COLMAP's ids.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Warning {
    /// Matches that stand still while the scene moves were left out.
    StationaryMatches {
        /// Number of matches.
        matches: usize,
        /// Number of pairs that have no others.
        watermark_pairs: usize,
        /// Where.
        overlays: Vec<OverlayReport>,
    },
    /// The images give several models that share nothing.
    SeveralModels {
        /// Number of images of each.
        images: Vec<usize>,
        /// Where each model but the first comes closest to a larger one.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        gaps: Vec<ModelGap>,
    },
    /// The focal length of a camera is far from the expected one.
    FocalLength {
        /// Folder of the model.
        model: String,
        /// The camera.
        camera: u32,
        /// Focal length, in pixels.
        focal_px: f64,
        /// The focal length of EXIF or the user, in pixels; none if it is not known.
        expected_px: Option<f64>,
        /// Larger side of the images, in pixels.
        side_px: u32,
    },
    /// The images hardly determine the focal length of a camera.
    UncertainFocalLength {
        /// Folder of the model.
        model: String,
        /// The camera.
        camera: u32,
        /// Focal length, in pixels.
        focal_px: f64,
        /// Its standard deviation, in pixels.
        sd_px: f64,
        /// Whether a calibration was given, and is refined.
        is_calibrated: bool,
    },
    /// The images contradict the calibration of a camera.
    ContradictedCalibration {
        /// Folder of the model.
        model: String,
        /// The camera.
        camera: u32,
        /// What moved by most standard deviations.
        change: ParameterChange,
    },
    /// The distortion of a camera is not that of a lens.
    Distortion {
        /// Folder of the model.
        model: String,
        /// The camera.
        camera: u32,
        /// COLMAP's name of the camera model.
        camera_model: String,
        /// The parameters.
        params: Vec<f64>,
    },
    /// The lens model leaves residuals that depend on the distance from the centre.
    LensResiduals {
        /// Folder of the model.
        model: String,
        /// The camera.
        camera: u32,
        /// COLMAP's name of the camera model.
        camera_model: String,
        /// Their root mean square, in pixels.
        residual_px: f64,
        /// A camera model that may fit.
        better: String,
    },
    /// Images have another focal length than the camera that they share.
    ImagesOfOtherFocalLength {
        /// Folder of the model.
        model: String,
        /// The camera.
        camera: u32,
        /// The images, the largest deviation first.
        images: Vec<ScaledImage>,
    },
    /// The relative poses of two cameras of a rig scatter.
    RigScatter {
        /// Folder of the model.
        model: String,
        /// Folders of the cameras.
        cameras: [String; 2],
        /// Root mean square distance from the mean, relative to the baseline.
        relative: f64,
    },
    /// The baseline of a rig changes from the first half of a drive to the second.
    RigDrift {
        /// Folder of the model.
        model: String,
        /// Folders of the cameras.
        cameras: [String; 2],
        /// Mean baseline of the second half over that of the first.
        change: f64,
    },
    /// Images are far from where those before and after place them.
    Jumps {
        /// Folder of the model.
        model: String,
        /// The images.
        images: Vec<String>,
    },
    /// Images with few observations.
    FewObservations {
        /// Folder of the model.
        model: String,
        /// The images and the number of their observations.
        images: Vec<(String, usize)>,
    },
    /// The images agree with a camera that only turned.
    OneSpot {
        /// Folder of the model.
        model: String,
        /// Median error of rotations, relative to that of the model.
        error_ratio: f64,
        /// The focal length of that camera, in pixels.
        focal_px: f64,
        /// Whether its lens is a fisheye.
        is_fisheye: bool,
    },
    /// Points behind the cameras that observe them.
    PointsBehind {
        /// Folder of the model.
        model: String,
        /// Number of observations.
        observations: usize,
    },
}

/// An image that contradicts its camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct ScaledImage {
    /// Its name.
    pub name: String,
    /// Its focal length over that of the camera. The points were fitted with that one, so that the
    /// true ratio is farther from 1.
    pub scale: f64,
    /// Standard deviation of the ratio.
    pub sd: f64,
}

/// How a refined parameter of a camera differs from its calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct ParameterChange {
    /// COLMAP's name of the parameter.
    pub parameter: String,
    /// Its calibrated value.
    pub given: f64,
    /// Its refined value.
    pub found: f64,
    /// Their difference, in standard deviations.
    pub deviations: f64,
}

/// Where a model comes closest to a larger one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(expecting = "an object")]
pub struct ModelGap {
    /// Its folder.
    pub model: String,
    /// Folder of the larger model; none if no pair across is verified.
    pub nearest: Option<String>,
    /// The pair across with the most verified matches: an image of the larger model and one of
    /// this.
    pub images: Option<[String; 2]>,
    /// Number of its matches.
    pub matches: usize,
}

impl Warning {
    /// Whether the warning is on matches, which are known before a model is.
    pub(crate) fn is_of_matches(&self) -> bool {
        matches!(self, Self::StationaryMatches { .. })
    }

    /// Whether the relative poses of a rig in the model of a folder are not constant.
    pub(crate) fn is_of_rig(&self, folder: &str) -> bool {
        match self {
            Self::RigScatter { model, .. } | Self::RigDrift { model, .. } => model == folder,
            _ => false,
        }
    }
}
