use tiepoint_adjust::FocalPrior;
use tiepoint_geometry::Rng;
use tiepoint_scene::{CorrespondenceGraph, KnownRigs, Reconstruction};

use crate::options::MapperOptions;
use crate::rigs::RigPairs;

/// What all models of a run have in common.
#[derive(Clone, Copy)]
pub(super) struct Input<'a> {
    pub(super) graph: &'a CorrespondenceGraph,
    /// Cameras with initial focal lengths, and images without poses.
    pub(super) scene: &'a Reconstruction,
    pub(super) options: &'a MapperOptions,
    pub(super) focal_priors: &'a [FocalPrior],
    /// Camera pairs of the paper's rig term.
    pub(super) rig_pairs: &'a [RigPairs],
    /// Rigs with known extrinsics.
    pub(super) known_rigs: Option<&'a KnownRigs>,
}

impl<'a> Input<'a> {
    /// The input of a trial: without priors and rigs.
    pub(super) fn of_trial(
        graph: &'a CorrespondenceGraph,
        scene: &'a Reconstruction,
        options: &'a MapperOptions,
    ) -> Self {
        Self { graph, scene, options, focal_priors: &[], rig_pairs: &[], known_rigs: None }
    }

    pub(super) fn seed_of(&self, key: &[u64]) -> u64 {
        Rng::stream(self.options.seed, key).next_u64()
    }
}
