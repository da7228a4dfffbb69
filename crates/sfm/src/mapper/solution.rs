use tiepoint_scene::Reconstruction;

use crate::rigs::CalibratedRig;
use crate::rolling_shutter::RollingShutters;

/// A model under construction with the results of its stages. A failed stage restores it.
#[derive(Clone)]
pub(super) struct Solution {
    pub(super) model: Reconstruction,
    /// Noise scale of the keypoints as a multiple of their nominal standard deviation; set when all
    /// images are registered.
    pub(super) noise: Option<f64>,
    /// Rolling shutters; `None` if they are not asked for, or could not be estimated.
    pub(super) shutters: Option<RollingShutters>,
    pub(super) num_loop_pairs: usize,
    pub(super) rig: Option<CalibratedRig>,
}

impl Solution {
    pub(super) fn new(model: Reconstruction) -> Self {
        Self { model, noise: None, shutters: None, num_loop_pairs: 0, rig: None }
    }
}
