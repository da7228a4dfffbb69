//! Column blocks of the reduced system, and the location of each variable in them.

/// Index of a block, tile or variable that does not exist.
pub(crate) const NONE: u32 = u32::MAX;

/// A range of adjacent columns of the reduced system: the tangent directions of one kept variable,
/// or of several that were merged.
#[derive(Clone, Debug)]
pub(crate) struct ColumnBlock {
    pub(crate) dof: usize,
    /// First element in padded vectors over all blocks, in which each block has `padded(dof)`
    /// elements.
    pub(crate) padded_start: usize,
    /// Bit i: column i is free.
    pub(crate) free: u64,
    /// First of its free columns in the reduced system.
    pub(crate) first_column: usize,
}

impl ColumnBlock {
    /// Indices of the free columns, ascending.
    pub(crate) fn free_columns(&self) -> impl Iterator<Item = usize> + use<> {
        let free = self.free;
        (0..self.dof).filter(move |&column| free >> column & 1 == 1)
    }
    pub(crate) fn num_free(&self) -> usize {
        self.free.count_ones() as usize
    }
    pub(crate) fn whole(&self) -> bool {
        self.num_free() == self.dof
    }
}

/// Block of a variable and its first column in that block. `block == NONE` for fixed and eliminated
/// variables.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Location {
    pub(crate) block: u32,
    pub(crate) offset: u32,
    /// Index of its [`VariableClass`](super::ordering::VariableClass).
    pub(super) class: u32,
}
