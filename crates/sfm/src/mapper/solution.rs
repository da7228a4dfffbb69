use std::collections::{BTreeMap, BTreeSet};

use tiepoint_scene::{CameraId, ImagePair, Reconstruction};

use crate::mapped_model::OtherPlace;
use crate::rigs::CalibratedRig;
use crate::rolling_shutter::RollingShutters;

/// A model under construction with the results of its stages. A failed stage restores it.
#[derive(Clone)]
pub(super) struct Solution {
    pub(super) model: Reconstruction,
    pub(super) phase: Phase,
    /// The initial pair; `None` for a model that goes on from another one.
    pub(super) initial_pair: Option<ImagePair>,
    /// Whether the model is in the frame of the caller's terms.
    pub(super) is_in_frame_of_terms: bool,
    /// Rolling shutters; `None` if they are not asked for, or could not be estimated.
    pub(super) shutters: Option<RollingShutters>,
    pub(super) num_loop_pairs: usize,
    pub(super) rig: Option<CalibratedRig>,
    /// Logarithm of the Bayes factor against the exact calibration of each camera that was tested.
    pub(super) calibration_evidence: BTreeMap<CameraId, f64>,
    /// Cameras without a calibration whose intrinsics are those of a fit with lens fields.
    pub(super) kept_intrinsics: BTreeSet<CameraId>,
    /// Standard deviations of the intrinsics; `None` after an adjustment.
    pub(super) intrinsics_sds: Option<BTreeMap<CameraId, Vec<f64>>>,
    /// Standard deviations of intrinsics by a fit with lens fields.
    pub(super) field_sds: BTreeMap<CameraId, Vec<f64>>,
    /// Places that look like this one, and are others.
    pub(super) other_places: Vec<OtherPlace>,
    /// Number of images at the last selection of camera models.
    pub(super) images_at_lens_test: usize,
}

/// Phase of the construction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// Images are being registered. The residuals show the errors of the poses, not the noise of
    /// the keypoints.
    Growing,
    /// All images are registered.
    Complete {
        /// Noise scale of the keypoints as a multiple of their nominal standard deviation.
        noise: f64,
    },
}

impl Solution {
    pub(super) fn new(model: Reconstruction) -> Self {
        Self {
            model,
            phase: Phase::Growing,
            initial_pair: None,
            is_in_frame_of_terms: false,
            shutters: None,
            num_loop_pairs: 0,
            rig: None,
            calibration_evidence: BTreeMap::new(),
            kept_intrinsics: BTreeSet::new(),
            intrinsics_sds: None,
            field_sds: BTreeMap::new(),
            other_places: Vec::new(),
            images_at_lens_test: 0,
        }
    }
}
