//! Loop closure: detection of loops that drift left open, and their correction.

mod pairs;
mod pose_graph;

pub(crate) use pairs::{CovisibilityGraph, MIN_PAIRS, Pairs, is_closed, join, pairs};
pub(crate) use pose_graph::{LoopConstraint, consistent_set, distribute_drift};
