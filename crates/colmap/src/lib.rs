#![doc = include_str!("../README.md")]

mod extract;
mod map;
mod models;
mod output;
mod pairs;
mod rigs;
mod scene;
mod triangulate;

pub use extract::{ExtractOptions, Extracted, SharedCamera, extract};
pub use map::{MapDatabaseOptions, MappedFolder, map};
pub use models::{
    AdjustModelOptions, Aligned, AlignedTo, adjust, align, color, convert_to_ply, merge, write_as,
};
pub use output::write_model;
pub use pairs::{DatabasePairs, match_database};
pub use rigs::configure_rigs;
pub use scene::create_database;
pub use tiepoint_pipeline as pipeline;
pub use triangulate::{TriangulateOptions, register, triangulate};
