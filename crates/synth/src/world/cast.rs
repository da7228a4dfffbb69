//! What a ray meets first.

use tiepoint_geometry::nalgebra::Vector3;

use super::bvh::{LANES, Packet};
use super::hit::Hit;
use super::model::{GROUND, MOVER_QUADS, MOVERS, World};
use super::mover::MoverPose;
use super::quad::Ray;

/// Nothing is seen beyond this distance but the sky, in metres.
const HORIZON_M: f64 = 3000.0;
/// What is nearer to the eye than this is not seen, in metres.
const NEAREST_M: f64 = 0.05;

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

impl World {
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

    /// Whether nothing lies between the origin of a ray and the end of its direction, but for
    /// `slack` of its length.
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

    /// What sixteen rays meet: ids for [`World::resolve`]. `movers` are the moving cars to look at,
    /// with their poses by lane.
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
}
