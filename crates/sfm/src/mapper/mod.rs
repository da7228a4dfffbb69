//! The incremental mapper.

mod calibration;
mod camera_models;
mod checkpoint;
mod existing;
mod extend;
mod focal_trials;
mod growth;
mod incremental;
mod input;
mod intrinsics_sds;
mod join;
mod known_rigs;
mod loops;
mod merge;
mod refinement_schedule;
mod refiner;
mod run;
mod solution;
mod stages;
mod start;
mod submap;
mod term_frame;
#[cfg(test)]
mod test_scene;
mod uncertain_focal_lengths;

pub use checkpoint::CheckpointStore;
pub use existing::ExistingPoses;
pub use run::Mapper;
