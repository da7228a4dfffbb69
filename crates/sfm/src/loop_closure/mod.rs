//! Loops that drift left open: found, and closed.

mod pairs;
mod pose_graph;

pub(crate) use pairs::{Joined, MIN_PAIRS, Pairs, is_closed, join, pairs};
pub(crate) use pose_graph::{Meeting, agreeing, spread_drift};
