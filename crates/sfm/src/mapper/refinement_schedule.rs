//! Refinement schedules of the mapping stages.

use crate::tracks::TOLERANCE_BEFORE_TRACK_UPDATE;

/// Limits of a refinement.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RefinementSchedule {
    /// Maximum number of rounds of track re-creation and adjustment.
    pub(crate) rounds: usize,
    /// Relative decrease of the cost below which an adjustment ends.
    pub(crate) tolerance: f64,
    /// Maximum number of iterations of an adjustment.
    pub(crate) max_iterations: usize,
    /// Whether only selected points take part ([`crate::adjust::AdjustOptions::select_tracks`]).
    pub(crate) select_tracks: bool,
}

impl RefinementSchedule {
    /// The initial pair.
    pub(crate) const INITIAL: Self =
        Self { rounds: 1, tolerance: 1e-5, max_iterations: 50, select_tracks: true };
    /// A new image with its neighbours.
    pub(crate) const LOCAL: Self =
        Self { rounds: 1, tolerance: 1e-4, max_iterations: 25, select_tracks: true };
    /// Global refinement during growth.
    pub(crate) const GROWING: Self =
        Self { rounds: 1, tolerance: 1e-5, max_iterations: 30, select_tracks: true };
    /// Global refinement of the complete model, before loop detection.
    pub(crate) const BEFORE_LOOP_CLOSURE: Self =
        Self { rounds: 1, select_tracks: true, ..Self::FINAL.before_track_update() };
    /// After loop closure.
    pub(crate) const AFTER_LOOP_CLOSURE: Self =
        Self { rounds: 3, select_tracks: true, ..Self::FINAL };
    /// Estimation of the rig.
    pub(crate) const RIG: Self = Self { select_tracks: true, ..Self::FINAL };
    /// The final refinement. With a tolerance of 1e-6 the mapping takes a quarter to a half more
    /// time, because distant points converge slowly, and the trajectories on KITTI change by a
    /// thousandth of their error.
    pub(crate) const FINAL: Self =
        Self { rounds: 5, tolerance: 1e-5, max_iterations: 100, select_tracks: false };
    /// After rolling-shutter correction.
    pub(crate) const RECTIFIED: Self = Self { rounds: 1, ..Self::FINAL };

    /// The schedule of an adjustment after which the tracks are updated.
    pub(crate) const fn before_track_update(&self) -> Self {
        Self { tolerance: self.tolerance.max(TOLERANCE_BEFORE_TRACK_UPDATE), ..*self }
    }
}
