//! What there is in a world.

use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::Vector3;

use super::bvh::{Bvh, NOTHING};
use super::ground::Ground;
use super::material::Surface;
use super::mover::{self, Mover, MoverPose};
use super::options::StreetOptions;
use super::quad::{Quad, Ray};
use super::{furniture, street};
use crate::error::{Error, require};
use crate::route::Route;

/// Ids of what a ray can meet: quads below, then the quads of each moving car, then the ground.
pub(super) const GROUND: u32 = NOTHING - 1;
pub(super) const MOVERS: u32 = 1 << 31;
/// Quads of one moving car, at most.
pub(super) const MOVER_QUADS: u32 = 1 << 8;

/// A world to drive through.
#[derive(Clone, Debug)]
pub struct World {
    pub(super) quads: Vec<Quad>,
    pub(super) surfaces: Vec<Surface>,
    pub(super) bvh: Bvh,
    pub(super) ground: Option<Ground>,
    pub(super) movers: Vec<Mover>,
    pub(super) sky_seed: u32,
    pub(super) towards_sun: Vector3<f64>,
}

impl World {
    /// A street along a route, with everything that stands and drives there; another world for
    /// every seed.
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
        let (azimuth, elevation) =
            (std::f64::consts::TAU * rng.uniform(), 0.5 + 0.5 * rng.uniform());
        world.towards_sun = Vector3::new(
            azimuth.cos() * elevation.cos(),
            azimuth.sin() * elevation.cos(),
            elevation.sin(),
        );
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

    /// Whether a point lies on something that stands still, or in one of its openings, to within
    /// `slack_m`: looked up the slow way.
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
                is_beside
                    && out < slack_m
                    && out > -relief.map_or(0.0, |relief| relief.depth_m) - slack_m
            })
    }
}
