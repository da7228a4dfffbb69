#![doc = include_str!("../README.md")]

pub mod convert;
pub mod diagnostics;
mod error;
mod event;
pub mod frame_names;
mod known_frames;
mod loop_closure;
mod mapped_model;
mod mapper;
pub mod model_tools;
mod options;
pub mod positions;
pub mod register;
pub mod rigs;
pub mod rolling_shutter;
mod saved;
mod student_t;
pub mod submaps;
mod terms;
mod timeline;
pub mod tracks;
pub mod two_view;

pub use error::Error;
pub use event::{Event, Failure, OptionalStage};
pub use mapped_model::{MappedModel, OtherPlace};
pub use mapper::{CheckpointStore, ExistingPoses, Mapper};
pub use options::{MapperOptions, RigMode};
pub use tiepoint_adjust as adjust;
pub use tiepoint_ba as ba;
pub use tiepoint_geometry as geometry;
pub use tiepoint_matching as matching;
pub use tiepoint_rig as rig;
pub use tiepoint_scene as scene;
