//! Blocks, the stretches of columns of the reduced system, and which variable is where in them.

/// "There is none."
pub(crate) const NONE: u32 = u32::MAX;

/// A stretch of columns of the reduced system.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    pub(crate) dof: usize,
    /// Where its numbers begin in vectors over all blocks, where each takes `padded(dof)`.
    pub(crate) at: usize,
    /// Bit i: column i is free.
    pub(crate) free: u64,
    /// First of its free columns in the reduced system.
    pub(crate) reduced: usize,
}

impl Block {
    /// The free columns, in order.
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

/// Where a variable went: its block and the first column in it. `block == NONE`: fixed, or
/// eliminated.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub(crate) block: u32,
    pub(crate) offset: u32,
    /// Variables with the same number look the same to a factor's [`Shape`](super::Shape).
    pub(super) class: u32,
}
