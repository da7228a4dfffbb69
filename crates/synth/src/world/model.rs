//! The world: static quads, ground, sky and moving cars.

use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::Vector3;

use super::builder::Builder;
use super::bvh::{Bvh, NOTHING};
use super::ground::Ground;
use super::material::Surface;
use super::moving_car::{self, MovingCar, MovingCarPose};
use super::options::StreetOptions;
use super::quad::{Quad, Ray};
use super::{furniture, scenes, street};
use crate::error::{Error, require};
use crate::route::Route;

/// Ids of the surfaces of ray hits: static quads from 0, then the quads of each moving car, then
/// the ground.
pub(super) const GROUND: u32 = NOTHING - 1;
pub(super) const MOVING_CAR_IDS: u32 = 1 << 31;
/// Range of ids of one moving car: most quads of a car.
pub(super) const MOVING_CAR_QUADS: u32 = 1 << 8;

/// A world that can be rendered.
#[derive(Clone, Debug)]
pub struct World {
    pub(super) quads: Vec<Quad>,
    pub(super) surfaces: Vec<Surface>,
    pub(super) bvh: Bvh,
    pub(super) ground: Option<Ground>,
    pub(super) moving_cars: Vec<MovingCar>,
    pub(super) sky_seed: u32,
    pub(super) towards_sun: Vector3<f64>,
}

impl World {
    /// A street along a route with static objects and moving cars, which follow from the seed.
    ///
    /// # Errors
    ///
    /// [`Error::OutOfRange`] if a fraction is not in 0..=1.
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
        Ok(Self::beside(route, built, options.moving_cars, seed))
    }

    /// A highway along a route with little beside it, and with moving cars.
    pub fn highway(route: &Route, moving_cars: usize, seed: u64) -> Self {
        Self::beside(route, street::build_highway(route, seed), moving_cars, seed)
    }

    /// An object on a table, in the open.
    pub(crate) fn table(seed: u64) -> Self {
        let built = scenes::table(&mut Rng::stream(seed, &[5]));
        Self::from_quads(built.quads, built.surfaces)
    }

    /// A room.
    pub(crate) fn room(seed: u64) -> Self {
        let built = scenes::room(&mut Rng::stream(seed, &[6]));
        Self::from_quads(built.quads, built.surfaces)
    }

    /// Two identical houses beside a straight road.
    pub(crate) fn twins(road: &Route, seed: u64) -> Self {
        Self::beside(road, scenes::twins(&mut Rng::stream(seed, &[7])), 0, seed)
    }

    /// A route between objects, under a sky.
    fn beside(route: &Route, built: Builder, moving_cars: usize, seed: u64) -> Self {
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
        world.moving_cars = moving_car::traffic(route, moving_cars, &mut rng);
        world
    }

    /// A world of given quads without ground, for calibration targets and tests. The field
    /// `surface` of a quad is an index into `surfaces`.
    pub fn from_quads(quads: Vec<Quad>, surfaces: Vec<Surface>) -> Self {
        let bvh = Bvh::new(&quads);
        let towards_sun = Vector3::new(0.4, -0.3, 0.85).normalize();
        Self {
            quads,
            surfaces,
            bvh,
            ground: None,
            moving_cars: Vec::new(),
            sky_seed: 0,
            towards_sun,
        }
    }

    /// Number of static quads.
    pub fn num_quads(&self) -> usize {
        self.quads.len()
    }

    /// Indices of the moving cars that may be visible from a place at a time.
    pub(crate) fn moving_cars_near(&self, place: &Vector3<f64>, time_s: f64) -> Vec<usize> {
        let is_near = |moving_car: &MovingCar| {
            moving_car
                .pose(time_s)
                .is_some_and(|pose| (pose.position - place.xy()).norm() < moving_car::MAX_VISIBLE_M)
        };
        (0..self.moving_cars.len()).filter(|&index| is_near(&self.moving_cars[index])).collect()
    }

    /// Pose of a moving car at a time; `None` if it is not on the street.
    pub(crate) fn moving_car_pose(&self, moving_car: usize, time_s: f64) -> Option<MovingCarPose> {
        self.moving_cars[moving_car].pose(time_s)
    }

    /// Whether rays that deviate from this one by at most `slack` per metre may hit a moving car.
    pub(crate) fn moving_car_is_near(&self, pose: &MovingCarPose, ray: &Ray, slack: f64) -> bool {
        MovingCar::is_near(pose, ray, slack)
    }

    /// Whether a point lies on a static surface, or in one of its openings, to within `slack_m`;
    /// linear search.
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
