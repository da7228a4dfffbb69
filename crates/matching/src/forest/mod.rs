//! The randomized kd-forest of Muja and Lowe ("Scalable nearest neighbor algorithms for high
//! dimensional data", PAMI 2014, section 3.1; Silpa-Anan and Hartley 2008). Each kd-tree splits at
//! dimensions drawn at random among those of the highest variance. All trees are searched together,
//! best bin first, up to a number of leaves.
//!
//! The search is approximate. It is faster than brute force only above some tens of thousands of
//! features in an image, on CPUs with byte dot products.

mod build;
mod options;
mod search;
mod tree;

pub use options::{Checks, ForestOptions};
pub use tree::Forest;

#[cfg(test)]
mod tests;
