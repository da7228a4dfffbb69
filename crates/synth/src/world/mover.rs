//! Cars that drive along the street. They are rigid, so rays are taken into the car's frame instead
//! of the car into the world.

use tiepoint_geometry::Rng;
use tiepoint_geometry::nalgebra::{Vector2, Vector3};

use super::bvh::{Bvh, LANES, Packet};
use super::furniture::{car, in_range};
use super::material::Surface;
use super::quad::{Quad, Ray};
use crate::route::{Route, RoutePosition};

/// A car further away than this is not drawn, in metres.
pub(super) const SEEN_M: f64 = 250.0;
/// Radius of a ball around a car's middle, in metres.
const RADIUS_M: f64 = 2.6;
/// The lane of those who come towards us, in metres to the left of the centre line.
const LANE_LEFT_M: f64 = 1.75;
const SPEED_MPS: [f64; 2] = [7.0, 13.0];
const GAP_M: [f64; 2] = [12.0, 70.0];

/// A car that drives.
#[derive(Clone, Debug)]
pub(super) struct Mover {
    pub(super) quads: Vec<Quad>,
    pub(super) surfaces: Vec<Surface>,
    bvh: Bvh,
    route: Route,
    start_along_m: f64,
    speed_mps: f64,
}

/// Where a moving car is, seen from above.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MoverPose {
    pub(super) place: Vector2<f64>,
    cos: f64,
    sin: f64,
}

impl MoverPose {
    pub(super) fn direction_in_car(&self, v: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(self.cos * v.x + self.sin * v.y, self.cos * v.y - self.sin * v.x, v.z)
    }

    pub(super) fn direction_in_world(&self, v: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(self.cos * v.x - self.sin * v.y, self.sin * v.x + self.cos * v.y, v.z)
    }

    pub(super) fn ray_in_car(&self, ray: &Ray) -> Ray {
        let from_car = ray.origin - self.place.push(0.0);
        Ray {
            origin: self.direction_in_car(&from_car),
            direction: self.direction_in_car(&ray.direction),
        }
    }
}

impl Mover {
    /// Where it is; `None` where it has left, or not yet entered, an open street.
    pub(super) fn pose(&self, time_s: f64) -> Option<MoverPose> {
        let along_m = self.start_along_m - self.speed_mps * time_s;
        if !self.route.is_closed() && !(0.0..self.route.length_m()).contains(&along_m) {
            return None;
        }
        let place = self.route.point_beside(RoutePosition { along_m, left_m: LANE_LEFT_M });
        let (sin, cos) = (self.route.heading_rad(along_m) + std::f64::consts::PI).sin_cos();
        Some(MoverPose { place, cos, sin })
    }

    /// What a ray of the car's frame meets.
    pub(super) fn cast(&self, ray_in_car: &Ray, least: f64, most: f64) -> Option<(u32, f64)> {
        self.bvh
            .cast(&self.quads, ray_in_car, least, most)
            .map(|(quad, distance, _)| (quad, distance))
    }

    /// Whether rays near this one may meet the car where it is: `slack` is how far they may be
    /// apart, per metre.
    pub(super) fn is_near(pose: &MoverPose, ray: &Ray, slack: f64) -> bool {
        let towards = pose.place.push(0.0) - ray.origin;
        let (along, distance2) = (towards.dot(&ray.direction), towards.norm_squared());
        let reach = RADIUS_M + slack * distance2.sqrt();
        along > -reach && distance2 - along * along / ray.direction.norm_squared() < reach * reach
    }

    /// The same for a packet, given where the car is for each of its rays.
    pub(super) fn cast_packet(
        &self,
        packet: &mut Packet,
        poses: &[MoverPose; LANES],
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

/// Cars in the lane of those who come towards us, each at a speed of its own but not through one
/// another.
pub(super) fn traffic(route: &Route, count: usize, rng: &mut Rng) -> Vec<Mover> {
    let mut along = in_range(rng, 30.0, 60.0);
    // One speed for all: they keep their distances.
    let speed_mps = in_range(rng, SPEED_MPS[0], SPEED_MPS[1]);
    (0..count)
        .map(|_| {
            let start_along_m = along;
            along += in_range(rng, GAP_M[0], GAP_M[1]);
            let model = car(rng);
            let bvh = Bvh::new(&model.quads);
            let (quads, surfaces) = (model.quads, model.surfaces);
            Mover { quads, surfaces, bvh, route: route.clone(), start_along_m, speed_mps }
        })
        .collect()
}
