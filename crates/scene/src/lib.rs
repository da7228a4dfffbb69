#![doc = include_str!("../README.md")]

mod camera;
mod correspondence_graph;
mod error;
mod ids;
mod image;
mod intrinsics_prior;
mod known_rigs;
mod nearest_intrinsics;
mod original_ids;
mod position;
mod position_track;
mod reconstruction;
pub mod rig;
mod track;
mod two_view;
mod validate;

pub use camera::Camera;
pub use correspondence_graph::CorrespondenceGraph;
pub use error::Error;
pub use ids::{CameraId, FrameId, ImageId, PointId, RigId};
pub use image::{Image, Keypoint};
pub use intrinsics_prior::IntrinsicsPrior;
pub use known_rigs::KnownRigs;
pub use nearest_intrinsics::nearest_intrinsics;
pub use original_ids::OriginalIds;
pub use position::{Georeference, Place, Position};
pub use position_track::PositionTrack;
pub use reconstruction::Reconstruction;
pub use rig::{Frame, Rig, RigSensor};
pub use tiepoint_geometry as geometry;
pub use track::{Observation, Track};
pub use two_view::{ImagePair, Match, TwoView, TwoViewKind};
