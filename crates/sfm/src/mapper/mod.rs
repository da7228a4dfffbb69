//! The incremental mapper.

mod extend;
mod focal_trials;
mod growth;
mod incremental;
mod known_rigs;
mod loops;
mod refinement_schedule;
mod solution;
mod stages;
mod start;
mod support;
#[cfg(test)]
mod test_scene;
mod transaction;

pub use extend::{Existing, extend};
pub use incremental::{map, map_with_rigs};
