//! Options of the kd-forest.

/// Number of leaves that a search visits: the "checks" of FLANN. At least one leaf per tree is
/// visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Checks {
    /// Total over all trees, as in FLANN.
    Total(u32),
    /// Mean per tree. The trees share one priority queue, so that the leaves of a tree can be more
    /// or fewer.
    PerTree(u32),
}

impl Default for Checks {
    fn default() -> Self {
        Checks::Total(64)
    }
}

/// Options of the construction of a forest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ForestOptions {
    /// Number of trees.
    pub trees: u32,
    /// Seed of the random choice of split dimensions.
    pub seed: u64,
}

impl Default for ForestOptions {
    fn default() -> Self {
        ForestOptions { trees: 8, seed: 0 }
    }
}
