//! What a ray met, to the last bit.

use tiepoint_geometry::nalgebra::Vector3;

use super::model::{GROUND, MOVER_QUADS, MOVERS, World};
use super::mover::MoverPose;
use super::quad::{Part, Ray};

/// What a ray met, in double precision.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    pub(crate) id: u32,
    pub(crate) distance: f64,
    pub(crate) point: Vector3<f64>,
    /// Towards the eye.
    pub(crate) normal: Vector3<f64>,
    pub(super) part: Part,
    /// Directions of the surface's coordinates, and where on it the point lies.
    pub(super) tangents: [Vector3<f64>; 2],
    pub(super) uv: [f64; 2],
}

impl Hit {
    /// Equal for neighbouring pixels exactly where they see the same smooth piece of a surface.
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
    /// The point where a ray meets what it is known to meet; `None` if it does not, after all.
    pub(crate) fn resolve(
        &self,
        id: u32,
        ray: &Ray,
        mover_pose: impl Fn(usize) -> Option<MoverPose>,
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
        if id >= MOVERS {
            let (mover, quad) = ((id - MOVERS) / MOVER_QUADS, (id - MOVERS) % MOVER_QUADS);
            let mover = &self.movers[mover as usize];
            let pose = mover_pose(((id - MOVERS) / MOVER_QUADS) as usize)?;
            let local = pose.ray_in_car(ray);
            let quad = &mover.quads[quad as usize];
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

    /// Key of what a ray is known to meet (see [`Hit::key`]), the id in its upper half.
    pub(crate) fn key(
        &self,
        id: u32,
        ray: &Ray,
        mover_pose: impl Fn(usize) -> Option<MoverPose>,
    ) -> u64 {
        let has_parts = (id as usize) < self.quads.len()
            && self.surfaces[self.quads[id as usize].surface as usize].relief.is_some();
        let hit = if has_parts { self.resolve(id, ray, mover_pose) } else { None };
        hit.map_or(u64::from(id) << 32, |hit| hit.key())
    }
}
