//! The database of COLMAP: one SQLite file with cameras, rigs, images, frames, keypoints,
//! descriptors, matches and two-view geometries. Written with the schema of COLMAP 4.2.1; read from
//! any version.
//!
//! In a file of this program, an id is the index of [`tiepoint_scene`] plus one. The images and
//! cameras of a file of another program get indices in the order of their ids.
//!
//! Each `write_*` is one transaction. An open file has a write-ahead log beside it;
//! [`Database::close`] checkpoints the log, so that one file remains.
//!
//! Two tables are not in COLMAP's schema: `tiepoint_photos` has the fingerprints of the photos, and
//! `tiepoint_stages` records the inputs of the stages that
//! filled the other tables. COLMAP ignores it.

mod append;
mod connection;
mod copy;
mod create;
#[cfg(feature = "faults")]
mod faulty_vfs;
mod features;
mod guard;
mod pairs;
mod photos;
mod pose_priors;
mod read_only;
mod rigs;
mod schema;
mod stages;
mod tile;

pub use connection::{Database, DatabaseFrame};
pub use stages::{StageRow, read_stage_rows};
pub use tile::{TileReader, TileWriter};
