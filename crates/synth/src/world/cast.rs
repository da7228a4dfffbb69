//! Ray casting: the first hit of a ray.

use tiepoint_geometry::nalgebra::Vector3;

use super::bvh::{LANES, Packet};
use super::hit::Hit;
use super::model::{GROUND, MOVING_CAR_IDS, MOVING_CAR_QUADS, World};
use super::moving_car::MovingCarPose;
use super::quad::Ray;

/// Largest distance of a hit, in metres; beyond it is the sky.
const HORIZON_M: f64 = 3000.0;
/// Smallest distance of a hit, in metres.
const NEAREST_M: f64 = 0.05;

/// The hit of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position in the world, in metres.
    pub point_in_world: Vector3<f64>,
    /// Unit normal, towards the camera.
    pub normal: Vector3<f64>,
    /// Distance from the origin of the ray, in units of the length of its direction.
    pub distance: f64,
    /// Whether the surface belongs to a moving car.
    pub is_moving: bool,
}

impl World {
    /// The first hit of a ray at a time; `None` for the sky.
    pub fn cast(&self, ray: &Ray, time_s: f64) -> Option<SurfacePoint> {
        let hit = self.cast_within(ray, time_s, HORIZON_M)?;
        Some(SurfacePoint {
            point_in_world: hit.point,
            normal: hit.normal,
            distance: hit.distance,
            is_moving: (MOVING_CAR_IDS..GROUND).contains(&hit.id),
        })
    }

    /// Whether nothing occludes the end point of a ray (origin + direction); `slack` is a tolerance
    /// as a fraction of its length.
    pub(crate) fn is_clear(&self, ray: &Ray, time_s: f64, slack: f64) -> bool {
        self.cast_within(ray, time_s, 1.0).is_none_or(|hit| hit.distance > 1.0 - slack)
    }

    fn cast_within(&self, ray: &Ray, time_s: f64, max_distance: f64) -> Option<Hit> {
        let mut limit = max_distance;
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
        for (index, moving_car) in self.moving_cars.iter().enumerate() {
            let Some(pose) = moving_car.pose(time_s) else { continue };
            if let Some((quad, distance)) = moving_car.cast(&pose.ray_in_car(ray), NEAREST_M, limit)
            {
                (best, limit) =
                    (Some(MOVING_CAR_IDS + index as u32 * MOVING_CAR_QUADS + quad), distance);
            }
        }
        self.resolve(best?, ray, |moving_car| self.moving_cars[moving_car].pose(time_s))
    }

    /// Casts sixteen rays: ids for [`World::resolve`]. `moving_cars` are the moving cars to test,
    /// with their poses for each ray.
    pub(crate) fn cast_packet(
        &self,
        packet: &mut Packet,
        moving_cars: &[(usize, [MovingCarPose; LANES])],
    ) {
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
        for (moving_car, poses) in moving_cars {
            self.moving_cars[*moving_car].cast_packet(
                packet,
                poses,
                MOVING_CAR_IDS + *moving_car as u32 * MOVING_CAR_QUADS,
            );
        }
        self.bvh.cast_packet(packet, 0);
    }
}
