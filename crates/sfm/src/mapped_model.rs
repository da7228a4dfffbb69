use std::collections::BTreeMap;

use tiepoint_scene::{ImageId, ImagePair, Reconstruction};

use crate::event::Failure;
use crate::rigs::CalibratedRig;
use crate::rolling_shutter::{RollingShutter, RowPoses};

/// A model with everything that was found out about it.
#[derive(Clone, Debug, PartialEq)]
pub struct MappedModel {
    /// Cameras, images with poses, points; frames where cameras are held rigidly.
    pub reconstruction: Reconstruction,
    /// The images that the model began with. With the paper's rig term the first of them is at the
    /// origin.
    pub initial_pair: ImagePair,
    /// Of cameras that ride together, with a rig term that looks for their mounting; `None` where
    /// there is nothing to hold, or that failed.
    pub rig: Option<CalibratedRig>,
    /// The shutters of its cameras, where they are known or were to be found.
    pub shutters: Vec<RollingShutter>,
    /// Where the cameras were while each row was exposed: of images with a rolling shutter whose
    /// motion is known.
    pub row_poses: BTreeMap<ImageId, RowPoses>,
    /// Pairs of images that drift had torn apart where the way meets itself, and that are one place
    /// now.
    pub num_loop_pairs: usize,
    /// Stages that failed: the model is as it would be without them.
    pub failures: Vec<Failure>,
}
