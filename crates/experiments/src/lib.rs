#![doc = include_str!("../README.md")]

mod collection_folder;
mod demo;
mod drive_evaluation;
mod drive_folder;
mod error;
mod paper;
mod progress;

pub use collection_folder::{RenderedCollection, render_collection};
pub use demo::{DemoOptions, DemoOutcome, demo};
pub use drive_folder::{
    BASELINE_M, Plan, Rendered, RenderedCamera, render, write_depths, write_scan,
};
pub use error::Error;
pub use paper::{ExperimentOutcome, Scenery, constraints, view_directions};
pub use progress::Progress;
pub use tiepoint_pipeline as pipeline;
pub use tiepoint_synth as synth;
