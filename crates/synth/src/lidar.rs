//! The reference cloud of a VLP-16 laser scanner on the roof: 16 rings over 30°, 0.2° in azimuth,
//! up to 100 m, with an accuracy of ±3 cm.
//!
//! Each ray starts from the pose of the vehicle at its own time, so that the cloud is exact up to
//! range noise. Moving cars are left out, as in a cleaned survey.

use std::f64::consts::TAU;

use rayon::prelude::*;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::{Rigid3, Rng};

use crate::Drive;
use crate::error::{Error, require};
use crate::world::Ray;

/// Position in the vehicle frame, in metres: centre of the roof, above the cameras.
const POSITION_M: [f64; 3] = [0.0, -1.9, 1.1];

/// Options of a spinning laser scanner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarOptions {
    /// Number of rings, evenly spaced over `elevation_range_rad`.
    pub rings: usize,
    /// Angle between the lowest and the highest ring, centred at the horizon, in radians.
    pub elevation_range_rad: f64,
    /// Angle between consecutive rays of a ring, in radians.
    pub azimuth_step_rad: f64,
    /// Rotation rate, in turns per second.
    pub turns_per_s: f64,
    /// Records every n-th turn.
    pub every_turns: usize,
    /// Largest range, in metres.
    pub max_range_m: f64,
    /// Standard deviation of a range, in metres.
    pub noise_m: f64,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for LidarOptions {
    /// The data sheet of the VLP-16; ±3 cm are two standard deviations.
    fn default() -> Self {
        Self {
            rings: 16,
            elevation_range_rad: 30f64.to_radians(),
            azimuth_step_rad: 0.2f64.to_radians(),
            turns_per_s: 10.0,
            every_turns: 1,
            max_range_m: 100.0,
            noise_m: 0.015,
            seed: 0,
        }
    }
}

/// Scans the whole drive: points in the world, in metres, in the order of time.
///
/// # Errors
///
/// [`Error::OutOfRange`] if an option is out of its range.
pub fn reference_cloud(drive: &Drive, options: &LidarOptions) -> Result<Vec<Vector3<f64>>, Error> {
    require(options.turns_per_s > 0.0, "turns_per_s", options.turns_per_s, "more than 0")?;
    require(
        options.azimuth_step_rad > 1e-5,
        "azimuth_step_rad",
        options.azimuth_step_rad,
        "more than 1e-5",
    )?;
    require(options.every_turns > 0, "every_turns", 0.0, "at least 1")?;
    let turns = (drive.trajectory().duration_s() * options.turns_per_s) as usize;
    let turns: Vec<usize> = (0..turns).step_by(options.every_turns).collect();
    let clouds: Vec<Vec<Vector3<f64>>> =
        turns.par_iter().map(|&turn| sweep(drive, options, turn)).collect();
    Ok(clouds.concat())
}

fn sweep(drive: &Drive, options: &LidarOptions, turn: usize) -> Vec<Vector3<f64>> {
    let mut rng = Rng::stream(options.seed, &[20, turn as u64]);
    let vehicle_from_lidar = Rigid3::new(Default::default(), Vector3::from(POSITION_M));
    let steps = (TAU / options.azimuth_step_rad).round() as usize;
    let mut points = Vec::with_capacity(steps * options.rings / 2);
    for step in 0..steps {
        let turned = step as f64 / steps as f64;
        let time_s = (turn as f64 + turned) / options.turns_per_s;
        let world_from_lidar = drive.trajectory().world_from_vehicle(time_s) * vehicle_from_lidar;
        let (sin, cos) = (TAU * turned).sin_cos();
        for ring in 0..options.rings {
            let noise_m = options.noise_m * rng.normal();
            let up = (ring as f64 / (options.rings.max(2) - 1) as f64 - 0.5)
                * options.elevation_range_rad;
            let direction = Vector3::new(sin * up.cos(), -up.sin(), cos * up.cos());
            let ray = Ray {
                origin: world_from_lidar.translation,
                direction: world_from_lidar.rotation * direction,
            };
            let Some(hit) = drive.world().cast(&ray, time_s) else { continue };
            if hit.distance < options.max_range_m && !hit.is_moving {
                points.push(ray.at(hit.distance + noise_m));
            }
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DriveOptions, Effects, RouteKind};

    #[test]
    fn points_lie_on_surfaces_and_noise_has_its_standard_deviation() {
        let effects = Effects { moving_cars: 4, suspension: 1.0, ..Effects::default() };
        let options = DriveOptions {
            route: RouteKind::Open,
            length_m: 60.0,
            effects,
            ..DriveOptions::default()
        };
        let drive = Drive::new(&options).unwrap();
        let scanner = LidarOptions {
            every_turns: 20,
            azimuth_step_rad: 4f64.to_radians(),
            ..LidarOptions::default()
        };
        let exact = reference_cloud(&drive, &LidarOptions { noise_m: 0.0, ..scanner }).unwrap();
        let noisy = reference_cloud(&drive, &scanner).unwrap();
        assert!(exact.len() > 1000 && exact.len() == noisy.len(), "{} points", exact.len());
        let squares: f64 = exact.iter().zip(&noisy).map(|(a, b)| (a - b).norm_squared()).sum();
        let deviation = (squares / exact.len() as f64).sqrt();
        // With 1,000 ranges the standard deviation is known to 2 %.
        assert!((deviation / scanner.noise_m - 1.0).abs() < 0.1, "{deviation} m");
        assert!(exact.iter().all(|point| drive.world().touches(point, 1e-6)));
        let off = noisy.iter().filter(|point| !drive.world().touches(point, 1e-6)).count();
        assert!(off > exact.len() / 3, "{off} of {}: the test cannot see noise", exact.len());
    }
}
