//! Buffers of the elimination of one task.

/// Vector loads of the last row of a batch may reach beyond it by less than this: the widest merged
/// block.
pub(super) const SLACK: usize = 32;

/// Buffers of the elimination of one task.
pub(super) struct Workspace<'a> {
    /// C − YᵀY without damping. Of a block with itself only the lower triangle is valid.
    pub(super) tiles: &'a mut [f64],
    pub(super) stash: &'a mut [f64],
    pub(super) vectors: &'a mut [f64],
    pub(super) rows: &'a mut [f64],
    pub(super) w: &'a mut [f64],
    pub(super) y: &'a mut [f64],
    pub(super) projected: &'a mut [f64],
    pub(super) gradient_max: f64,
}
