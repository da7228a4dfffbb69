#![doc = include_str!("../README.md")]

mod error;
mod lens;
mod rigs;
mod route;
mod trajectory;

pub use error::Error;
pub use lens::{ActionLens, Lens};
pub use rigs::{Mount, Mounting};
pub use route::{Route, RoutePosition};
pub use tiepoint_geometry as geometry;
pub use trajectory::{Motion, Trajectory, Velocity};
