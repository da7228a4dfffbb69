//! Loop closure: detection of loops that drift left open, and their correction.

mod pairs;
mod pose_graph;

pub(crate) use pairs::{
    ClassifiedPairs, CovisibilityGraph, MIN_PAIRS, classify_pairs, is_closed, merge_matched_points,
};
pub(crate) use pose_graph::{LoopConstraint, consistent_set, distribute_drift};
