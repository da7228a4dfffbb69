//! The work of COLMAP's commands, on the databases and folders that a caller names: no workspace.
//!
//! A database is added to, never replaced: images, matches and two-view geometries that it has stay
//! as they are. A folder that the caller names as the output gets the new model, whoever made the
//! old one.

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
    AdjustModelOptions, Aligned, AlignedTo, adjust, align, convert_to_ply, merge, write_as,
};
pub use output::write_model;
pub use pairs::{DatabasePairs, match_database};
pub use rigs::configure_rigs;
pub use triangulate::{TriangulateOptions, register, triangulate};
