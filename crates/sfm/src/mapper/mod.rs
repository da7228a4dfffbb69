//! The incremental mapper.

mod explained;
mod focal_trials;
mod growth;
mod incremental;
mod loops;
mod refinement_schedule;
mod solution;
mod stages;
mod start;
#[cfg(test)]
mod test_scene;
mod transaction;

pub use incremental::map;
