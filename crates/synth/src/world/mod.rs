//! A street that can be looked at: quads in a tree, the ground, the sky, and cars that move.

mod builder;
mod building;
mod bvh;
mod furniture;
mod ground;
mod material;
mod mover;
mod noise;
mod quad;
mod shade;
mod sky;
mod street;

use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::Vector3;

use crate::error::{Error, require};
use crate::route::Route;
use bvh::Bvh;
pub(crate) use bvh::{LANES, NOTHING, Packet};
use ground::Ground;
pub use material::{Material, Surface};
use mover::Mover;
pub(crate) use mover::MoverPose;
pub use quad::{Quad, Ray, Relief};
pub(crate) use shade::{Hit, Pixel};

/// Ids of what a ray can meet: quads below, then the quads of each moving car, then the ground.
const GROUND: u32 = NOTHING - 1;
const MOVERS: u32 = 1 << 31;
/// Quads of one moving car, at most.
const MOVER_QUADS: u32 = 1 << 8;
/// Nothing is seen beyond this distance but the sky, in metres.
pub(crate) const HORIZON_M: f64 = 3000.0;
/// What is nearer to the eye than this is not seen, in metres.
const NEAREST_M: f64 = 0.05;

/// What stands along a street.
#[derive(Clone, Debug, PartialEq)]
pub struct StreetOptions {
    /// Share of the fronts that begin a terrace of equal houses.
    pub repeated_fraction: f64,
    /// Share of the house ends followed by a gap with a garden.
    pub gap_fraction: f64,
    /// Share of the parking bays that are taken.
    pub parked_fraction: f64,
    /// Share of the places for a tree that have one.
    pub tree_fraction: f64,
    /// Cars that drive, each a few car lengths to a hundred metres from the next.
    pub moving_cars: usize,
}

impl Default for StreetOptions {
    fn default() -> Self {
        Self {
            repeated_fraction: 0.2,
            gap_fraction: 0.35,
            parked_fraction: 0.45,
            tree_fraction: 0.6,
            moving_cars: 0,
        }
    }
}

/// What a ray met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Where, in the world.
    pub point_in_world: Vector3<f64>,
    /// Unit normal, towards the eye.
    pub normal: Vector3<f64>,
    /// Distance from the ray's origin, in units of the ray's direction.
    pub distance: f64,
    /// Whether it belongs to something that moves.
    pub is_moving: bool,
}

/// A world to drive through.
#[derive(Clone, Debug)]
pub struct World {
    quads: Vec<Quad>,
    surfaces: Vec<Surface>,
    bvh: Bvh,
    ground: Option<Ground>,
    movers: Vec<Mover>,
    sky_seed: u32,
    towards_sun: Vector3<f64>,
}

impl World {
    /// A street along a route, with everything that stands and drives there; another world for every seed.
    pub fn street(route: &Route, options: &StreetOptions, seed: u64) -> Result<Self, Error> {
        for (name, value) in [
            ("repeated_fraction", options.repeated_fraction),
            ("gap_fraction", options.gap_fraction),
            ("parked_fraction", options.parked_fraction),
            ("tree_fraction", options.tree_fraction),
        ] {
            require((0.0..=1.0).contains(&value), name, value, "0 to 1")?;
        }
        let built = street::build(route, options, seed);
        let mut rng = Rng::stream(seed, &[4]);
        let ground = Ground::new(route, furniture::seed(&mut rng));
        let mut world = Self::from_quads(built.quads, built.surfaces);
        world.ground = Some(ground);
        world.sky_seed = furniture::seed(&mut rng);
        let (azimuth, elevation) = (std::f64::consts::TAU * rng.uniform(), 0.5 + 0.5 * rng.uniform());
        world.towards_sun =
            Vector3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
        world.movers = mover::traffic(route, options.moving_cars, &mut rng);
        Ok(world)
    }

    /// Any quads in front of the sky, for targets and tests. Each names its surface by index.
    pub fn from_quads(quads: Vec<Quad>, surfaces: Vec<Surface>) -> Self {
        let bvh = Bvh::new(&quads);
        let towards_sun = Vector3::new(0.4, -0.3, 0.85).normalize();
        Self { quads, surfaces, bvh, ground: None, movers: Vec::new(), sky_seed: 0, towards_sun }
    }

    /// How many quads stand still.
    pub fn num_quads(&self) -> usize {
        self.quads.len()
    }

    /// What a ray meets first at a time; `None` for the sky.
    pub fn cast(&self, ray: &Ray, time_s: f64) -> Option<SurfacePoint> {
        let hit = self.cast_within(ray, time_s, HORIZON_M)?;
        Some(SurfacePoint {
            point_in_world: hit.point,
            normal: hit.normal,
            distance: hit.distance,
            is_moving: (MOVERS..GROUND).contains(&hit.id),
        })
    }

    /// Whether nothing lies between the origin of a ray and the end of its direction, but for `slack` of its length.
    pub(crate) fn is_clear(&self, ray: &Ray, time_s: f64, slack: f64) -> bool {
        self.cast_within(ray, time_s, 1.0).is_none_or(|hit| hit.distance > 1.0 - slack)
    }

    fn cast_within(&self, ray: &Ray, time_s: f64, most: f64) -> Option<Hit> {
        let mut limit = most;
        let mut best = None;
        if self.ground.is_some() && ray.direction.z < 0.0 {
            let distance = -ray.origin.z / ray.direction.z;
            if distance > NEAREST_M && distance < limit {
                (best, limit) = (Some(GROUND), distance);
            }
        }
        if let Some((quad, distance, _)) = self.bvh.cast(&self.quads, ray, NEAREST_M, limit) {
            (best, limit) = (Some(quad), distance);
        }
        for (index, mover) in self.movers.iter().enumerate() {
            let Some(pose) = mover.pose(time_s) else { continue };
            if let Some((quad, distance)) = mover.cast(&pose.ray_in_car(ray), NEAREST_M, limit) {
                (best, limit) = (Some(MOVERS + index as u32 * MOVER_QUADS + quad), distance);
            }
        }
        self.resolve(best?, ray, |mover| self.movers[mover].pose(time_s))
    }

    /// The moving cars that may be seen from a place at a time.
    pub(crate) fn movers_near(&self, place: &Vector3<f64>, time_s: f64) -> Vec<usize> {
        let is_near = |mover: &Mover| {
            mover.pose(time_s).is_some_and(|pose| (pose.place - place.xy()).norm() < mover::SEEN_M)
        };
        (0..self.movers.len()).filter(|&index| is_near(&self.movers[index])).collect()
    }

    /// Where a moving car is at a time; `None` where it is not on the street.
    pub(crate) fn mover_pose(&self, mover: usize, time_s: f64) -> Option<MoverPose> {
        self.movers[mover].pose(time_s)
    }

    /// Whether rays that differ from this one by at most `slack` per metre may meet a moving car.
    pub(crate) fn mover_is_near(&self, pose: &MoverPose, ray: &Ray, slack: f64) -> bool {
        Mover::is_near(pose, ray, slack)
    }

    /// What sixteen rays meet: ids for [`World::resolve`]. `movers` are the moving cars to look at, with their poses by lane.
    pub(crate) fn cast_packet(&self, packet: &mut Packet, movers: &[(usize, [MoverPose; LANES])]) {
        if self.ground.is_some() {
            for lane in 0..LANES {
                let distance = -packet.origin[2][lane] / packet.direction[2][lane];
                if packet.direction[2][lane] < 0.0
                    && distance > NEAREST_M as f32
                    && distance < HORIZON_M as f32
                {
                    (packet.nearest[lane], packet.id[lane]) = (distance, GROUND);
                }
            }
        }
        for (mover, poses) in movers {
            self.movers[*mover].cast_packet(packet, poses, MOVERS + *mover as u32 * MOVER_QUADS);
        }
        self.bvh.cast_packet(packet, 0);
    }

    /// Key of what a ray is known to meet (see [`Hit::key`]), the id in its upper half.
    pub(crate) fn key(&self, id: u32, ray: &Ray, mover_pose: impl Fn(usize) -> Option<MoverPose>) -> u64 {
        let has_parts = (id as usize) < self.quads.len()
            && self.surfaces[self.quads[id as usize].surface as usize].relief.is_some();
        let hit = if has_parts { self.resolve(id, ray, mover_pose) } else { None };
        hit.map_or(u64::from(id) << 32, |hit| hit.key())
    }

    /// Whether a point lies on something that stands still, or in one of its openings, to within `slack_m`: looked up the slow
    /// way.
    #[cfg(test)]
    pub(crate) fn touches(&self, point: &Vector3<f64>, slack_m: f64) -> bool {
        let is_on_ground = self.ground.is_some() && point.z.abs() < slack_m;
        is_on_ground
            || self.quads.iter().any(|quad| {
                let relief = self.surfaces[quad.surface as usize].relief;
                let local = point - quad.origin;
                let out = local.dot(&quad.normal());
                let is_beside = [quad.u, quad.v]
                    .iter()
                    .zip(quad.size)
                    .all(|(axis, size)| (-slack_m..size + slack_m).contains(&local.dot(axis)));
                is_beside && out < slack_m && out > -relief.map_or(0.0, |relief| relief.depth_m) - slack_m
            })
    }
}
