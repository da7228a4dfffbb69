use std::collections::{BTreeMap, BTreeSet};

use tiepoint_geometry::RowPoses;
use tiepoint_scene::{CameraId, ImageId, ImagePair, Reconstruction};

use crate::event::Failure;
use crate::rigs::CalibratedRig;
use crate::rolling_shutter::RollingShutter;

/// A model with the results of its optional stages.
#[derive(Clone, Debug, PartialEq)]
pub struct MappedModel {
    /// Cameras, registered images and points; frames if the cameras are constrained rigidly.
    pub reconstruction: Reconstruction,
    /// The initial pair; `None` for a model that went on from another one
    /// ([`crate::Mapper::existing`]). With the paper's rig term the first image is at the origin.
    pub initial_pair: Option<ImagePair>,
    /// Whether the model is in the frame of the terms ([`crate::Mapper::term`]).
    pub is_in_frame_of_terms: bool,
    /// Result of the rig calibration; `None` without a rig term that calibrates, without images to
    /// constrain, or if the stage failed.
    pub rig: Option<CalibratedRig>,
    /// Logarithm of the Bayes factor against the exact calibration of each camera that was tested,
    /// of all cameras of the model together ([`tiepoint_adjust::calibration_evidence`]). Where it
    /// is at most 5, they are exact.
    pub calibration_evidence: BTreeMap<CameraId, f64>,
    /// Standard deviations of the parameters of each registered camera, in their order and units; 0
    /// for constant ones, unless a fit with a lens field tells of them. They hold where errors are
    /// correlated along tracks and in a part of the image. Empty if none was refined or the images
    /// do not determine them.
    pub intrinsics_sds: BTreeMap<CameraId, Vec<f64>>,
    /// Rolling shutters of the cameras, given or estimated.
    pub shutters: Vec<RollingShutter>,
    /// Motion during the exposure of each rolling-shutter image whose motion is known.
    pub row_poses: BTreeMap<ImageId, RowPoses>,
    /// Number of image pairs reconnected by loop closure.
    pub num_loop_pairs: usize,
    /// Images of a place that looks like the one of this model, and is another one: the mapper
    /// had put both on one place. The model is not joined with a model of them.
    pub other_place: BTreeSet<ImageId>,
    /// Stages that failed. The model is as it would be without them.
    pub failures: Vec<Failure>,
}

impl MappedModel {
    /// Whether the places of two models look alike, and are known as two: most images of one are in
    /// [`MappedModel::other_place`] of the other one.
    pub fn is_other_place_than(&self, other: &Self) -> bool {
        let has = |of: &Self, model: &Self| {
            let images = || model.reconstruction.registered();
            let num_others = images().filter(|(id, ..)| of.other_place.contains(id)).count();
            2 * num_others > images().count()
        };
        has(self, other) || has(other, self)
    }
}
