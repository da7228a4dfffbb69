//! State shared by the estimation steps of the rig, and joint refinement of a model and its
//! extrinsics.

use std::collections::BTreeSet;

use tiepoint_adjust::{AdjustOptions, RefineIntrinsics, Term};
use tiepoint_scene::{CameraId, CorrespondenceGraph, Reconstruction};

use super::extrinsics::RigExtrinsics;
use super::extrinsics_term::adjust_with_extrinsics;
use crate::Error;
use crate::tracks::{
    FilterOptions, TOLERANCE_BEFORE_TRACK_UPDATE, TrackOptions, filter_all_points, update_tracks,
};

/// Factor on the merge threshold of tracks directly after cameras moved relative to each other.
pub(super) const MERGE_ERROR_FACTOR: f64 = 2.0;
pub(super) const ITERATIONS: usize = 50;

/// What is not known of the intrinsics of cameras without a calibration, but held by the
/// adjustments.
#[derive(Clone, Copy)]
pub(crate) struct HeldIntrinsics<'a> {
    /// What is not known, whether it is refined or held.
    pub(crate) unknown: RefineIntrinsics,
    /// Cameras whose intrinsics are constant.
    pub(crate) constant: &'a BTreeSet<CameraId>,
}

/// Inputs that the rig estimation takes from the mapper.
pub(crate) struct Context<'a> {
    pub(crate) graph: &'a CorrespondenceGraph,
    pub(crate) tracks: &'a TrackOptions,
    pub(crate) filter: &'a FilterOptions,
    pub(crate) adjust: AdjustOptions<'a>,
    pub(crate) held: HeldIntrinsics<'a>,
    /// Further terms of the adjustments.
    pub(crate) terms: Vec<&'a mut dyn Term>,
    pub(crate) seed: u64,
}

impl Context<'_> {
    /// Runs bundle adjustment, re-creates tracks from the adjusted poses, runs bundle adjustment
    /// again and filters points. `merge_error_factor` scales the merge threshold of tracks.
    pub(super) fn refine(
        &mut self,
        model: &mut Reconstruction,
        all_extrinsics: &mut [RigExtrinsics],
        merge_error_factor: f64,
    ) -> Result<(), Error> {
        let options = AdjustOptions { max_iterations: ITERATIONS, ..self.adjust };
        let function_tolerance = options.function_tolerance.max(TOLERANCE_BEFORE_TRACK_UPDATE);
        let first = AdjustOptions { function_tolerance, ..options };
        adjust_with_extrinsics(model, &first, all_extrinsics, &mut self.terms)?;
        let tracks = TrackOptions {
            max_merge_error_px: merge_error_factor * self.tracks.max_merge_error_px,
            ..*self.tracks
        };
        update_tracks(self.graph, model, &tracks);
        adjust_with_extrinsics(model, &options, all_extrinsics, &mut self.terms)?;
        filter_all_points(model, self.filter);
        Ok(())
    }
}
