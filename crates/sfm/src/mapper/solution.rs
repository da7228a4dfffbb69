use tiepoint_scene::Reconstruction;

use crate::rigs::CalibratedRig;
use crate::rolling_shutter::RollingShutters;

/// A model in the making with what was found out about it: what a stage that fails leaves as it
/// was.
#[derive(Clone)]
pub(super) struct Solution {
    pub(super) model: Reconstruction,
    /// Of the keypoints, as a multiple of what is expected; once all images that can be are
    /// registered.
    pub(super) noise: Option<f64>,
    /// What is known of rolling shutters; `None` where they are not asked for, or could not be
    /// found.
    pub(super) shutters: Option<RollingShutters>,
    pub(super) num_loop_pairs: usize,
    pub(super) rig: Option<CalibratedRig>,
}

impl Solution {
    pub(super) fn new(model: Reconstruction) -> Self {
        Self { model, noise: None, shutters: None, num_loop_pairs: 0, rig: None }
    }
}
