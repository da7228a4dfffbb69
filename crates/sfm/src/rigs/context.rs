//! What the steps that find how cameras are held have in common: a model is refined with its
//! mountings.

use tiepoint_scene::{CorrespondenceGraph, Reconstruction};

use super::extrinsics::RigExtrinsics;
use super::extrinsics_term::adjust_with_extrinsics;
use crate::Error;
use crate::adjust::AdjustOptions;
use crate::tracks::{FilterOptions, TrackOptions, filter_all_points, recreate_tracks};

/// Tracks are merged across cameras that were just brought together with this many times the usual
/// error.
pub(super) const WIDENED: f64 = 2.0;
pub(super) const ITERATIONS: usize = 50;

/// What the steps need of the mapper.
pub(crate) struct Context<'a> {
    pub(crate) graph: &'a CorrespondenceGraph,
    pub(crate) tracks: &'a TrackOptions,
    pub(crate) filter: &'a FilterOptions,
    pub(crate) adjust: AdjustOptions<'a>,
    pub(crate) seed: u64,
}

impl Context<'_> {
    /// Adjusts, re-creates tracks between the poses that came out, and adjusts again.
    pub(super) fn refine(
        &self,
        model: &mut Reconstruction,
        all_extrinsics: &mut [RigExtrinsics],
        widened: f64,
    ) -> Result<(), Error> {
        let options = AdjustOptions { max_iterations: ITERATIONS, ..self.adjust };
        adjust_with_extrinsics(model, &options, all_extrinsics)?;
        let tracks = TrackOptions {
            max_merge_error_px: widened * self.tracks.max_merge_error_px,
            ..*self.tracks
        };
        recreate_tracks(self.graph, model, &tracks);
        adjust_with_extrinsics(model, &options, all_extrinsics)?;
        filter_all_points(model, self.filter);
        Ok(())
    }
}
