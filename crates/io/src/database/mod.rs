//! COLMAP's database: one SQLite file with cameras, rigs, images, frames, keypoints, descriptors,
//! matches and two-view geometries. Written with the schema of COLMAP 4.2.1; read from any version.
//!
//! An id in the file is ours plus one where the file is ours. In a file of somebody else, the ids
//! of images and cameras are numbered in their order.
//!
//! Every `write_*` is one transaction. While it runs, the file has a write-ahead log beside it;
//! [`Database::finish`] folds the log in, so that one file remains.
//!
//! One table is not COLMAP's: `tiepoint_stages`, which tells what the rest was made from. COLMAP
//! passes it by.

mod connection;
mod create;
mod features;
mod guard;
mod pairs;
mod rigs;
mod schema;
mod stages;

pub use connection::{Database, Moment};
pub use stages::{StageRow, read_stage_rows};
