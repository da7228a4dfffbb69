//! How hard a model is worked on, at each stage of its making.

/// What a refinement or an adjustment may take.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RefinementSchedule {
    /// Rounds of re-triangulation and adjustment at most.
    pub(crate) rounds: usize,
    /// An adjustment ends when a step lowers the cost by less than this share,
    pub(crate) tolerance: f64,
    /// or after so many steps.
    pub(crate) max_iterations: usize,
    /// Whether points that are enough to place the images take part alone.
    pub(crate) selects_points: bool,
}

impl RefinementSchedule {
    /// For the pair that a model begins with.
    pub(crate) const INITIAL: Self =
        Self { rounds: 1, tolerance: 1e-5, max_iterations: 50, selects_points: true };
    /// For a new image with its neighbours.
    pub(crate) const LOCAL: Self =
        Self { rounds: 1, tolerance: 1e-4, max_iterations: 25, selects_points: true };
    /// For everything while it grows.
    pub(crate) const GROWING: Self =
        Self { rounds: 1, tolerance: 1e-5, max_iterations: 30, selects_points: true };
    /// For everything that has grown, to see where it does not hang together.
    pub(crate) const GROWN: Self = Self { rounds: 1, selects_points: true, ..Self::FINAL };
    /// For a loop that has just been closed.
    pub(crate) const CLOSED: Self = Self { rounds: 3, selects_points: true, ..Self::FINAL };
    /// To find how cameras are mounted.
    pub(crate) const HOLDING: Self = Self { selects_points: true, ..Self::FINAL };
    /// At the end. With a tolerance of 1e-6 all of mapping takes a quarter to a half more time,
    /// since far points creep on, and trajectories on KITTI change by a thousandth of their error.
    pub(crate) const FINAL: Self =
        Self { rounds: 5, tolerance: 1e-5, max_iterations: 100, selects_points: false };
    /// Between keypoints that a rolling shutter no longer shifts.
    pub(crate) const STRAIGHTENED: Self = Self { rounds: 1, ..Self::FINAL };
}
