#![doc = include_str!("../README.md")]

mod clocks;
mod collection;
mod drive;
pub mod effects;
mod error;
mod feature_scene;
pub mod lens;
mod lens_field;
mod lidar;
pub mod photometry;
pub mod render;
mod rigs;
pub mod route;
mod survey;
pub mod trajectory;
pub mod world;
mod write;

pub use clocks::Clock;
pub use collection::{Collection, CollectionCamera, CollectionKind, CollectionOptions, Photo};
pub use drive::{Drive, DriveCamera, DriveOptions, Exposure, RouteKind};
pub use effects::Effects;
pub use error::Error;
pub use feature_scene::{FeatureOptions, FeatureScene, MatchOptions, PairMatches};
pub use image;
pub use lens_field::LensField;
pub use lidar::{LidarOptions, reference_cloud};
pub use rigs::{Mount, ViewDirection};
pub use survey::{SurveyedPoint, surveyed_points};
pub use tiepoint_geometry as geometry;
