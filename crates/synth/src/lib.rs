#![doc = include_str!("../README.md")]

mod clocks;
mod drive;
mod effects;
mod error;
mod feature_scene;
mod lens;
mod lidar;
mod photometry;
mod render;
mod rigs;
mod route;
mod trajectory;
mod world;
mod write;

pub use clocks::Clock;
pub use drive::{Drive, DriveCamera, DriveOptions, Exposure, RouteKind};
pub use effects::{ClockEffects, Effects, PhotometryEffects, Switch};
pub use error::Error;
pub use feature_scene::{FeatureOptions, FeatureScene, MatchOptions, PairMatches};
pub use image;
pub use lens::{ActionLens, Lens};
pub use lidar::{LidarOptions, reference_cloud};
pub use photometry::{Development, develop};
pub use render::{Radiance, Renderer, RowPose};
pub use rigs::{Mount, ViewDirection};
pub use route::{Route, RoutePosition};
pub use tiepoint_geometry as geometry;
pub use trajectory::{Motion, Trajectory, Velocity};
pub use world::{Material, Quad, Ray, Relief, StreetOptions, Surface, SurfacePoint, World};
