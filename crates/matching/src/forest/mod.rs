//! The randomized kd-forest of Muja and Lowe ("Scalable nearest neighbor algorithms for high
//! dimensional data", PAMI 2014, section 3.1; Silpa-Anan and Hartley 2008): several kd-trees that
//! split at dimensions drawn at random among those of highest variance, searched together, best
//! branch first, until a number of leaves has been looked at.
//!
//! Approximate: some nearest neighbours are missed. It pays where brute force would be too slow,
//! which on a processor with byte products is only above some tens of thousands of features in an
//! image.

mod build;
mod options;
mod search;
mod tree;

pub use options::{Checks, ForestOptions};
pub use tree::Forest;

#[cfg(test)]
mod tests;
