//! Exact intersection of a ray with a surface that is known to be hit.

use tiepoint_geometry::nalgebra::Vector3;

use super::model::{GROUND, MOVING_CAR_IDS, MOVING_CAR_QUADS, World};
use super::moving_car::MovingCarPose;
use super::quad::{Part, Ray};

/// A ray hit in double precision.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    pub(crate) id: u32,
    pub(crate) distance: f64,
    pub(crate) point: Vector3<f64>,
    /// Unit normal, towards the camera.
    pub(crate) normal: Vector3<f64>,
    pub(super) part: Part,
    /// Tangents of the surface, and the position in surface coordinates, in metres.
    pub(super) tangents: [Vector3<f64>; 2],
    pub(super) uv: [f64; 2],
}

impl Hit {
    /// A key of the surface: neighbouring pixels have equal keys exactly if they see the same
    /// smooth region of a surface.
    pub(crate) fn key(&self) -> u64 {
        let part = match self.part {
            Part::Face => 0,
            Part::Pane { cell, .. } => 16 + cell[0] as u32 * 64 + cell[1] as u32,
            Part::Jamb { side } => 1 + u32::from(side),
        };
        u64::from(self.id) << 32 | u64::from(part)
    }
}

impl World {
    /// Intersects a ray with the surface `id`; `None` if the ray misses it.
    pub(crate) fn resolve(
        &self,
        id: u32,
        ray: &Ray,
        moving_car_pose: impl Fn(usize) -> Option<MovingCarPose>,
    ) -> Option<Hit> {
        if id == GROUND {
            let distance = -ray.origin.z / ray.direction.z;
            let point = ray.at(distance);
            let tangents = [Vector3::x(), Vector3::y()];
            let uv = [point.x, point.y];
            return Some(Hit {
                id,
                distance,
                point,
                normal: Vector3::z(),
                part: Part::Face,
                tangents,
                uv,
            });
        }
        if id >= MOVING_CAR_IDS {
            let (moving_car, quad) = (
                (id - MOVING_CAR_IDS) / MOVING_CAR_QUADS,
                (id - MOVING_CAR_IDS) % MOVING_CAR_QUADS,
            );
            let moving_car = &self.moving_cars[moving_car as usize];
            let pose = moving_car_pose(((id - MOVING_CAR_IDS) / MOVING_CAR_QUADS) as usize)?;
            let local = pose.ray_in_car(ray);
            let quad = &moving_car.quads[quad as usize];
            let (distance, uv) = quad.intersect_plane(&local)?;
            let side = -quad.normal().dot(&local.direction).signum();
            let [normal, u, v] =
                [quad.normal() * side, quad.u, quad.v].map(|d| pose.direction_in_world(&d));
            return Some(Hit {
                id,
                distance,
                point: ray.at(distance),
                normal,
                part: Part::Face,
                tangents: [u, v],
                uv,
            });
        }
        let quad = &self.quads[id as usize];
        let (wall_distance, wall_uv) = quad.intersect_plane(ray)?;
        let normal = quad.normal();
        let inwards = -normal.dot(&ray.direction);
        let mut hit = Hit {
            id,
            distance: wall_distance,
            point: ray.at(wall_distance),
            normal: normal * inwards.signum(),
            part: Part::Face,
            tangents: [quad.u, quad.v],
            uv: wall_uv,
        };
        if let (Some(relief), true) = (&self.surfaces[quad.surface as usize].relief, inwards > 0.0)
        {
            let slope = [quad.u, quad.v].map(|axis| axis.dot(&ray.direction) / inwards);
            let (depth, part) = relief.follow(wall_uv, slope);
            hit.distance += depth / inwards;
            hit.point = ray.at(hit.distance);
            hit.uv = [wall_uv[0] + slope[0] * depth, wall_uv[1] + slope[1] * depth];
            hit.part = part;
            if let Part::Jamb { side } = part {
                let axis = usize::from(side / 2);
                hit.normal = hit.tangents[axis] * if side % 2 == 0 { 1.0 } else { -1.0 };
                hit.tangents[axis] = normal;
                hit.uv[axis] = -depth;
            }
        }
        Some(hit)
    }

    /// Key of the surface `id` at the hit of a ray (see [`Hit::key`]), with the id in its upper
    /// half.
    pub(crate) fn key(
        &self,
        id: u32,
        ray: &Ray,
        moving_car_pose: impl Fn(usize) -> Option<MovingCarPose>,
    ) -> u64 {
        let has_parts = (id as usize) < self.quads.len()
            && self.surfaces[self.quads[id as usize].surface as usize].relief.is_some();
        let hit = if has_parts { self.resolve(id, ray, moving_car_pose) } else { None };
        hit.map_or(u64::from(id) << 32, |hit| hit.key())
    }
}
