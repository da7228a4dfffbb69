#![doc = include_str!("../README.md")]

mod error;
pub mod evaluation;
mod event;
pub mod models;
mod shard;
mod stage;
pub mod stages;
pub mod workspace;

pub use error::Error;
pub use event::{DenseStep, Event, Watch, emit};
pub use shard::Shard;
pub use stage::Stage;
pub use stages::reconstruct::{Options, reconstruct};
pub use tiepoint_dense as dense;
pub use tiepoint_eval as eval;
pub use tiepoint_input as input;
pub use tiepoint_io as io;
pub use tiepoint_sfm as sfm;
pub use tiepoint_store as store;
pub use workspace::folder::Workspace;
pub use workspace::report::Report;
