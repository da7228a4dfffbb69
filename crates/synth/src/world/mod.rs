//! A street that can be looked at: quads in a tree, the ground, the sky, and cars that move.

mod builder;
mod building;
mod bvh;
mod cast;
mod furniture;
mod ground;
mod hit;
mod material;
mod model;
mod mover;
mod noise;
mod options;
mod quad;
mod shade;
mod sky;
mod street;

pub(crate) use bvh::{LANES, NOTHING, Packet};
pub use cast::SurfacePoint;
pub(crate) use hit::Hit;
pub use material::{Material, Surface};
pub use model::World;
pub(crate) use mover::MoverPose;
pub use options::StreetOptions;
pub use quad::{Quad, Ray, Relief};
pub(crate) use shade::Pixel;
