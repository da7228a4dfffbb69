//! From what a ray met to the light that it brings.

use tiepoint_geometry::nalgebra::Vector3;

use super::hit::Hit;
use super::material::{mix, scale};
use super::model::{GROUND, MOVER_QUADS, MOVERS, World};
use super::noise::Footprint;
use super::quad::{Part, Ray};
use super::sky;

/// Light of the sky on a level and on an upright surface, and of the sun at right angles, relative
/// to white.
const SKY_LIGHT: [f32; 2] = [0.62, 0.46];
const SUN_LIGHT: f32 = 0.75;
/// Walls darken towards the ground, over about this height, in metres.
const CONTACT_M: f64 = 0.35;
/// From here up no eight-bit image shows it: 0.4 e⁻⁸ is below a thousandth.
const CONTACT_REACH_M: f64 = 8.0 * CONTACT_M;
/// What shows in glass below the sky.
const OPPOSITE: [f32; 3] = [0.20, 0.19, 0.18];

/// The ray of a pixel and how its direction changes by a pixel to the right and downwards.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pixel {
    pub(crate) ray: Ray,
    pub(crate) right: Vector3<f64>,
    pub(crate) down: Vector3<f64>,
}

impl World {
    /// The light that a pixel receives from what its ray met, or from the sky: linear red, green,
    /// blue, white about 1.
    pub(crate) fn radiance(&self, hit: Option<&Hit>, pixel: &Pixel) -> [f32; 3] {
        let direction = &pixel.ray.direction;
        let Some(hit) = hit else {
            return sky::radiance(
                direction,
                pixel.right.norm().max(pixel.down.norm()),
                self.sky_seed,
            );
        };
        // A step of the direction moves the point on its plane: dp = t (dd − d (n·dd)/(n·d)).
        let facing = hit.normal.dot(direction);
        let on_surface = |step: &Vector3<f64>| {
            let moved = (step - direction * (hit.normal.dot(step) / facing)) * hit.distance;
            hit.tangents.map(|tangent| tangent.dot(&moved))
        };
        let footprint = Footprint::new(on_surface(&pixel.right), on_surface(&pixel.down));
        let (albedo, mirror) = if hit.id == GROUND {
            match &self.ground {
                Some(ground) => (ground.albedo(hit.point.xy(), &footprint), 0.0),
                None => ([0.0; 3], 0.0),
            }
        } else {
            let (quads, surfaces, index) = if hit.id >= MOVERS {
                let mover = &self.movers[((hit.id - MOVERS) / MOVER_QUADS) as usize];
                (&mover.quads, &mover.surfaces, (hit.id - MOVERS) % MOVER_QUADS)
            } else {
                (&self.quads, &self.surfaces, hit.id)
            };
            surfaces[quads[index as usize].surface as usize].albedo(&hit.part, hit.uv, &footprint)
        };
        let upright = 1.0 - hit.normal.z.abs() as f32;
        let sky_light = SKY_LIGHT[0] + upright * (SKY_LIGHT[1] - SKY_LIGHT[0]);
        let contact = if upright > 0.0 && hit.point.z < CONTACT_REACH_M {
            1.0 - 0.4 * upright * (-hit.point.z.max(0.0) / CONTACT_M).exp() as f32
        } else {
            1.0
        };
        let recess = if hit.part == Part::Face { 1.0 } else { 0.8 };
        let sun = hit.normal.dot(&self.towards_sun).max(0.0) as f32;
        let light = (sky_light + SUN_LIGHT * sun) * contact * recess;
        let lit = scale(albedo, light);
        if mirror == 0.0 {
            return lit;
        }
        let mirrored = (direction - hit.normal * (2.0 * facing)).normalize();
        let seen = if mirrored.z > 0.25 {
            // Blurred: glass shows no small clouds.
            sky::radiance(&mirrored, 0.2, self.sky_seed)
        } else {
            OPPOSITE
        };
        let grazing = 1.0 + 2.0 * (1.0 - (facing / direction.norm()).abs() as f32).powi(4);
        mix(lit, seen, (mirror * grazing).min(0.9))
    }
}
