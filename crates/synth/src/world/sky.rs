//! The sky, clouds, and hills at the horizon: a function of the direction alone.

use tiepoint_geometry::nalgebra::Vector3;

use super::material::mix;
use super::noise::{Footprint, Fractal, smoothstep};

const ZENITH: [f32; 3] = [0.22, 0.40, 0.78];
const HORIZON: [f32; 3] = [0.72, 0.80, 0.90];
const CLOUD: [f32; 3] = [0.95, 0.95, 0.96];
const HILLS: [f32; 3] = [0.17, 0.24, 0.27];

fn round(width: f64) -> Footprint {
    Footprint::new([width, 0.0], [0.0, width])
}

/// Mean radiance over a footprint of the angular width `width_rad`.
pub(crate) fn radiance(direction: &Vector3<f64>, width_rad: f64, seed: u32) -> [f32; 3] {
    let direction = direction.normalize();
    let elevation = direction.z.clamp(-1.0, 1.0).asin();
    let up = elevation.max(0.0) as f32 / std::f32::consts::FRAC_PI_2;
    let mut color = mix(HORIZON, ZENITH, up.sqrt());
    if elevation > 0.03 {
        // Clouds are a texture on a horizontal plane.
        let plane = [direction.x / (direction.z + 0.08), direction.y / (direction.z + 0.08)];
        let width = width_rad / (direction.z + 0.08).powi(2);
        let noise =
            Fractal { coarsest: 1.1, octaves: 5, persistence: 0.55 }.at(plane, &round(width), seed);
        color = mix(color, CLOUD, 0.75 * smoothstep(noise * 0.9));
    }
    if elevation > 0.12 {
        return color;
    }
    // The skyline of hills: noise on a circle, so that it is continuous over the full azimuth.
    let level = direction.xy().norm().max(f64::MIN_POSITIVE);
    let circle = [direction.x, direction.y].map(|along| 8.0 * along / level);
    let ridge = 0.035
        + 0.025
            * f64::from(Fractal { coarsest: 2.0, octaves: 5, persistence: 0.5 }.at(
                circle,
                &round(1e-3),
                seed ^ 77,
            ));
    let below = ((ridge - elevation) / width_rad.max(1e-6) + 0.5).clamp(0.0, 1.0) as f32;
    if below == 0.0 {
        return color;
    }
    let azimuth = direction.y.atan2(direction.x);
    let woods = Fractal { coarsest: 0.02, octaves: 3, persistence: 0.8 }.at(
        [azimuth, elevation],
        &round(width_rad),
        seed ^ 78,
    );
    mix(color, HILLS.map(|c| c * (1.0 + 0.25 * woods)), below)
}
