//! What the inner loops work on.

/// Vector loads of the last row of a batch may reach beyond it by less than this: the widest merged
/// block.
pub(super) const SLACK: usize = 32;

/// The numbers of one chunk.
pub(super) struct Room<'a> {
    /// C − YᵀY without damping, in the chunk's tiles; of a block with itself only the lower
    /// triangle is meant.
    pub(super) tiles: &'a mut [f64],
    pub(super) stash: &'a mut [f64],
    pub(super) vectors: &'a mut [f64],
    pub(super) rows: &'a mut [f64],
    pub(super) w: &'a mut [f64],
    pub(super) y: &'a mut [f64],
    pub(super) turned: &'a mut [f64],
    pub(super) gradient_max: f64,
}
