//! Moving cars. They are rigid: rays are transformed into the frame of the car.

use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::{Vector2, Vector3};

use super::bvh::{Bvh, LANES, Packet};
use super::furniture::{car, in_range};
use super::material::Surface;
use super::quad::{Quad, Ray};
use crate::route::{Route, RoutePosition};

/// Largest distance of a rendered car, in metres.
pub(super) const MAX_VISIBLE_M: f64 = 250.0;
/// Radius of the bounding sphere of a car, in metres.
const RADIUS_M: f64 = 2.6;
/// Lateral offset of the lane of the oncoming traffic, in metres to the left of the centre line.
const LANE_LEFT_M: f64 = 1.75;
const SPEED_MPS: [f64; 2] = [7.0, 13.0];
const GAP_M: [f64; 2] = [12.0, 70.0];

/// A moving car.
#[derive(Clone, Debug)]
pub(super) struct MovingCar {
    pub(super) quads: Vec<Quad>,
    pub(super) surfaces: Vec<Surface>,
    bvh: Bvh,
    route: Route,
    start_along_m: f64,
    speed_mps: f64,
}

/// The pose of a moving car in the plane: position in metres, cosine and sine of the heading.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MovingCarPose {
    pub(super) position: Vector2<f64>,
    cos: f64,
    sin: f64,
}

impl MovingCarPose {
    pub(super) fn direction_in_car(&self, v: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(self.cos * v.x + self.sin * v.y, self.cos * v.y - self.sin * v.x, v.z)
    }

    pub(super) fn direction_in_world(&self, v: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(self.cos * v.x - self.sin * v.y, self.sin * v.x + self.cos * v.y, v.z)
    }

    pub(super) fn ray_in_car(&self, ray: &Ray) -> Ray {
        let from_car = ray.origin - self.position.push(0.0);
        Ray {
            origin: self.direction_in_car(&from_car),
            direction: self.direction_in_car(&ray.direction),
        }
    }
}

impl MovingCar {
    /// Its pose at a time; `None` before it enters or after it leaves an open street.
    pub(super) fn pose(&self, time_s: f64) -> Option<MovingCarPose> {
        let along_m = self.start_along_m - self.speed_mps * time_s;
        if !self.route.is_closed() && !(0.0..self.route.length_m()).contains(&along_m) {
            return None;
        }
        let position = self.route.point_beside(RoutePosition { along_m, left_m: LANE_LEFT_M });
        let (sin, cos) = (self.route.heading_rad(along_m) + std::f64::consts::PI).sin_cos();
        Some(MovingCarPose { position, cos, sin })
    }

    /// First hit of a ray in the frame of the car between two distances: quad index and distance.
    pub(super) fn cast(
        &self,
        ray_in_car: &Ray,
        min_distance: f64,
        max_distance: f64,
    ) -> Option<(u32, f64)> {
        self.bvh
            .cast(&self.quads, ray_in_car, min_distance, max_distance)
            .map(|(quad, distance, _)| (quad, distance))
    }

    /// Whether rays that deviate from this one by at most `slack` per metre may hit the bounding
    /// sphere of the car.
    pub(super) fn is_near(pose: &MovingCarPose, ray: &Ray, slack: f64) -> bool {
        let towards = pose.position.push(0.0) - ray.origin;
        let (along, distance2) = (towards.dot(&ray.direction), towards.norm_squared());
        let reach = RADIUS_M + slack * distance2.sqrt();
        along > -reach && distance2 - along * along / ray.direction.norm_squared() < reach * reach
    }

    /// Casts a packet of rays, given the pose of the car for each ray.
    pub(super) fn cast_packet(
        &self,
        packet: &mut Packet,
        poses: &[MovingCarPose; LANES],
        first_id: u32,
    ) {
        let mut local = *packet;
        for (lane, pose) in poses.iter().enumerate() {
            let vector =
                |part: &[[f32; LANES]; 3]| Vector3::from_fn(|axis, _| f64::from(part[axis][lane]));
            let ray = pose.ray_in_car(&Ray {
                origin: vector(&packet.origin),
                direction: vector(&packet.direction),
            });
            for axis in 0..3 {
                local.origin[axis][lane] = ray.origin[axis] as f32;
                local.direction[axis][lane] = ray.direction[axis] as f32;
            }
        }
        self.bvh.cast_packet(&mut local, first_id);
        (packet.nearest, packet.id) = (local.nearest, local.id);
    }
}

/// Moving cars in the lane of the oncoming traffic, all at the same speed with random gaps.
pub(super) fn traffic(route: &Route, count: usize, rng: &mut Rng) -> Vec<MovingCar> {
    let mut along = in_range(rng, 30.0, 60.0);
    // One speed for all cars preserves the gaps.
    let speed_mps = in_range(rng, SPEED_MPS[0], SPEED_MPS[1]);
    (0..count)
        .map(|_| {
            let start_along_m = along;
            along += in_range(rng, GAP_M[0], GAP_M[1]);
            let model = car(rng);
            let bvh = Bvh::new(&model.quads);
            let (quads, surfaces) = (model.quads, model.surfaces);
            MovingCar { quads, surfaces, bvh, route: route.clone(), start_along_m, speed_mps }
        })
        .collect()
}
