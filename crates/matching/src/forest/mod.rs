//! The randomized kd-forest of Muja and Lowe ("Scalable nearest neighbor algorithms for high dimensional data", PAMI 2014,
//! section 3.1; Silpa-Anan and Hartley 2008): several kd-trees that split at dimensions drawn at random among those of
//! highest variance, searched together, best branch first, until a number of leaves has been looked at.
//!
//! Approximate: some nearest neighbours are missed. It pays where brute force would be too slow, which on a processor with
//! byte products is only above some tens of thousands of features in an image.

mod build;
mod search;

use tiepoint_features::Descriptor;

use crate::brute::Isa;
use crate::matches::Nearest;
use build::Node;

/// How many leaves a search looks at: the "checks" of FLANN, the "searches" of others. Every tree is searched once at
/// least.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Checks {
    /// Over all trees together, as FLANN counts.
    Total(u32),
    /// For each tree; the trees still share one queue, so that those which promise more get more of the sum.
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

/// Randomized kd-trees over the descriptors of one image.
#[derive(Clone, Debug)]
pub struct Forest {
    descriptors: Vec<Row>,
    /// All trees one after the other, each in preorder.
    nodes: Vec<Node>,
    /// Where each tree begins in `nodes`.
    roots: Vec<u32>,
    /// Indices of descriptors in the order of the trees' leaves.
    points: Vec<u32>,
}

/// A descriptor that fills two cache lines and touches no third.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Row(Descriptor);

impl Forest {
    /// Grows the trees, in parallel; the result depends on the options only. At least one tree is grown.
    pub fn new(descriptors: &[Descriptor], options: &ForestOptions) -> Self {
        build::grow(descriptors.iter().map(|&d| Row(d)).collect(), options)
    }

    /// How many descriptors the forest holds.
    pub fn len(&self) -> usize {
        self.descriptors.len()
    }

    /// Whether it holds none.
    pub fn is_empty(&self) -> bool {
        self.descriptors.is_empty()
    }

    /// The number of trees.
    pub fn trees(&self) -> usize {
        self.roots.len()
    }

    /// For every query, the two nearest neighbours among the points that the search came across.
    pub fn nearest(&self, queries: &[Descriptor], checks: Checks) -> Vec<Nearest> {
        self.nearest_on(Isa::best(), queries, checks)
    }

    /// As [`Self::nearest`], on a given instruction set: for tests and measurements. All give the same result.
    pub fn nearest_on(&self, isa: Isa, queries: &[Descriptor], checks: Checks) -> Vec<Nearest> {
        search::search(self, isa, queries.iter().map(|&query| Row(query)), checks)
    }

    /// The neighbours of another forest's descriptors.
    pub(crate) fn nearest_of(&self, other: &Forest, checks: Checks) -> Vec<Nearest> {
        search::search(self, Isa::best(), other.descriptors.iter().copied(), checks)
    }
}

#[cfg(test)]
mod tests;
