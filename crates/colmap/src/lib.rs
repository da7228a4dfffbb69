#![doc = include_str!("../README.md")]

mod dense_lists;
mod extract;
mod fuse_maps;
mod map;
mod models;
mod output;
mod pairs;
mod patch_match;
mod rigs;
mod scene;
mod triangulate;

pub use extract::{ExtractOptions, Extracted, SharedCamera, extract};
pub use fuse_maps::{FuseOptions, FusedDepthMaps, fuse_depth_maps};
pub use map::{MapDatabaseOptions, MappedFolder, map};
pub use models::{
    AdjustModelOptions, Aligned, AlignedTo, adjust, align, color, convert_to_ply, merge, write_as,
};
pub use output::write_model;
pub use pairs::{DatabasePairs, match_database};
pub use patch_match::{DepthMapOptions, EstimatedDepthMaps, estimate_depth_maps};
pub use rigs::configure_rigs;
pub use scene::create_database;
pub use tiepoint_pipeline as pipeline;
pub use triangulate::{TriangulateOptions, register, triangulate};
