//! The street that is rendered: quads in a bounding volume hierarchy, the ground, the sky, and
//! moving cars.

mod builder;
mod building;
mod bvh;
mod cast;
mod furniture;
mod ground;
mod hit;
mod material;
mod model;
mod moving_car;
mod noise;
mod options;
mod quad;
mod scenes;
mod shade;
mod sky;
mod street;

pub(crate) use bvh::{LANES, NOTHING, Packet};
pub use cast::SurfacePoint;
pub(crate) use hit::Hit;
pub use material::{Material, Surface};
pub use model::World;
pub(crate) use moving_car::MovingCarPose;
pub use options::StreetOptions;
pub use quad::{Quad, Ray, Relief};
pub(crate) use scenes::{ROOM_M, TWINS_M};
pub(crate) use shade::Pixel;
