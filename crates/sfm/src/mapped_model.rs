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
    /// for constant ones, unless a fit with a lens field tells of them. A principal point that was
    /// held because no camera turns has that of a free one with its prior. They hold where errors
    /// are correlated along tracks and in a part of the image. Empty if none was refined or the
    /// images do not determine them.
    pub intrinsics_sds: BTreeMap<CameraId, Vec<f64>>,
    /// Rolling shutters of the cameras, given or estimated.
    pub shutters: Vec<RollingShutter>,
    /// Motion during the exposure of each rolling-shutter image whose motion is known.
    pub row_poses: BTreeMap<ImageId, RowPoses>,
    /// Number of image pairs reconnected by loop closure.
    pub num_loop_pairs: usize,
    /// Places that look like the one of this model.
    pub other_places: Vec<OtherPlace>,
    /// Stages that failed. The model is as it would be without them.
    pub failures: Vec<Failure>,
}

/// A place that looks like the one of a model, and is another one: the mapper had put both on one
/// place.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OtherPlace {
    /// Its images, which are not in the model.
    pub images: BTreeSet<ImageId>,
    /// Verified pairs between the images of the two places that contradicted the one place: they
    /// match what is between the places. The model is joined with one of the other place by these
    /// pairs alone.
    pub connections: BTreeSet<ImagePair>,
}

impl OtherPlace {
    /// Whether most images of a model are of this place.
    fn is_of(&self, model: &Reconstruction) -> bool {
        let num_of_place = model.registered().filter(|(id, ..)| self.images.contains(id)).count();
        2 * num_of_place > model.num_registered()
    }
}

impl MappedModel {
    /// Whether the places of two models look alike, and are known as two: most images of one are in
    /// [`OtherPlace::images`] of the other one.
    pub fn is_other_place_than(&self, other: &Self) -> bool {
        let has = |of: &Self, model: &Self| {
            of.other_places.iter().any(|place| place.is_of(&model.reconstruction))
        };
        has(self, other) || has(other, self)
    }
}
