//! What a caller may choose of a forest.

/// How many leaves a search looks at: the "checks" of FLANN, the "searches" of others. Every tree
/// is searched once at least.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Checks {
    /// Over all trees together, as FLANN counts.
    Total(u32),
    /// For each tree; the trees still share one queue, so that those which promise more get more of
    /// the sum.
    PerTree(u32),
}

impl Default for Checks {
    fn default() -> Self {
        Checks::Total(64)
    }
}

/// How to build a forest.
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
