//! Shading: the radiance of a ray hit.

use tiepoint_geometry::nalgebra::Vector3;

use super::hit::Hit;
use super::material::{mix, scale};
use super::model::{GROUND, MOVING_CAR_IDS, MOVING_CAR_QUADS, World};
use super::noise::Footprint;
use super::quad::{Part, Ray};
use super::sky;

/// Irradiance from the sky on a horizontal and on a vertical surface, and from the sun at normal
/// incidence, relative to white.
const SKY_LIGHT: [f32; 2] = [0.62, 0.46];
const SUN_LIGHT: f32 = 0.75;
/// Height over which walls darken towards the ground (ambient occlusion), in metres.
const CONTACT_M: f64 = 0.35;
/// Above this height the darkening is invisible in 8 bits: 0.4 e⁻⁸ is below a thousandth.
const CONTACT_REACH_M: f64 = 8.0 * CONTACT_M;
/// Radiance that glass reflects below the sky: the houses opposite.
const OPPOSITE: [f32; 3] = [0.20, 0.19, 0.18];

/// The ray of a pixel, and the change of its direction to the next pixel on the right and below.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pixel {
    pub(crate) ray: Ray,
    pub(crate) right: Vector3<f64>,
    pub(crate) down: Vector3<f64>,
}

impl World {
    /// The radiance of a pixel from the hit of its ray, or from the sky: linear red, green, blue;
    /// white is about 1.
    pub(crate) fn radiance(&self, hit: Option<&Hit>, pixel: &Pixel) -> [f32; 3] {
        let direction = &pixel.ray.direction;
        let Some(hit) = hit else {
            return sky::radiance(
                direction,
                pixel.right.norm().max(pixel.down.norm()),
                self.sky_seed,
            );
        };
        // A change dd of the direction moves the point on its plane by dp = t (dd − d
        // (n·dd)/(n·d)).
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
            let (quads, surfaces, index) = if hit.id >= MOVING_CAR_IDS {
                let moving_car =
                    &self.moving_cars[((hit.id - MOVING_CAR_IDS) / MOVING_CAR_QUADS) as usize];
                (
                    &moving_car.quads,
                    &moving_car.surfaces,
                    (hit.id - MOVING_CAR_IDS) % MOVING_CAR_QUADS,
                )
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
            // A wide footprint: the reflection has no small clouds.
            sky::radiance(&mirrored, 0.2, self.sky_seed)
        } else {
            OPPOSITE
        };
        let grazing = 1.0 + 2.0 * (1.0 - (facing / direction.norm()).abs() as f32).powi(4);
        mix(lit, seen, (mirror * grazing).min(0.9))
    }
}
