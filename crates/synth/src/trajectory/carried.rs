//! Cameras in a hand and on a drone: a path at constant speed, and sums of sines about it.

use std::f64::consts::{PI, TAU};

use tiepoint_geometry::Rng;

use super::sample::{STEP_S, Sample};
use crate::route::{Route, RoutePosition};

/// Waves of a coordinate: amplitude (metres or radians) and period in seconds.
type Waves = &'static [(f64, f64)];

/// How a carrier moves about its path.
pub(super) struct Sway {
    /// Lateral position on the path, in metres to the left.
    left_m: f64,
    /// Ranges of the height above the ground, in metres, and of the pitch upwards, in radians, one
    /// value of which a drive has.
    height_m: [f64; 2],
    pitch_rad: [f64; 2],
    /// Waves to the left, of yaw, pitch, roll, and upwards.
    waves: [Waves; 5],
}

/// A step takes half a second: the head goes up and down with each, and to the side and back with
/// two. Gaze wanders slowly, further to the sides than up and down.
pub(super) const HANDHELD: Sway = Sway {
    left_m: -7.4,
    height_m: [1.5, 1.7],
    pitch_rad: [-0.05, 0.05],
    waves: [
        &[(0.02, 1.0), (0.10, 6.1)],
        &[(0.14, 7.3), (0.08, 3.1), (0.008, 1.0)],
        &[(0.06, 5.3), (0.010, 0.5)],
        &[(0.025, 4.1), (0.012, 1.0)],
        &[(0.025, 0.5), (0.01, 3.7)],
    ],
};

/// Wind and its control, seen by a gimbal. The lowest flight is above the highest roof.
pub(super) const DRONE: Sway = Sway {
    left_m: 0.0,
    height_m: [30.0, 38.0],
    pitch_rad: [-1.05, -0.8],
    waves: [
        &[(0.4, 9.1), (0.1, 2.3)],
        &[(0.03, 8.3), (0.006, 1.1)],
        &[(0.02, 6.7), (0.006, 0.9)],
        &[(0.015, 5.9), (0.006, 1.3)],
        &[(0.5, 11.3), (0.1, 2.9)],
    ],
};

/// Moves along `distance_m` of a path at `speed_mps` over the ground: samples at 1 kHz.
pub(super) fn carry(
    path: &Route,
    sway: &Sway,
    speed_mps: f64,
    distance_m: f64,
    rng: &mut Rng,
) -> Vec<Sample> {
    let mut draw = |[low, high]: [f64; 2]| low + (high - low) * rng.uniform();
    let (height_m, pitch_rad) = (draw(sway.height_m), draw(sway.pitch_rad));
    let phases = sway.waves.map(|waves| waves.iter().map(|_| draw([0.0, TAU])).collect::<Vec<_>>());
    // Value and rate of a coordinate.
    let wave = |coordinate: usize, time_s: f64| {
        let mut sums = (0.0, 0.0);
        for (&(amplitude, period_s), phase) in
            sway.waves[coordinate].iter().zip(&phases[coordinate])
        {
            let (sin, cos) = (TAU * time_s / period_s + phase).sin_cos();
            sums = (sums.0 + amplitude * sin, sums.1 + amplitude * TAU / period_s * cos);
        }
        sums
    };
    let (mut samples, mut along_m, mut heading_rad) = (Vec::new(), 0.0, path.heading_rad(0.0));
    while along_m < distance_m {
        let time_s = samples.len() as f64 * STEP_S;
        // Headings of segments may differ by whole turns.
        heading_rad += (path.heading_rad(along_m) - heading_rad + PI).rem_euclid(TAU) - PI;
        let [left, yaw, pitch, roll, up] = [0, 1, 2, 3, 4].map(|k| wave(k, time_s));
        let left_m = sway.left_m + left.0;
        let place = path.point_beside(RoutePosition { along_m, left_m });
        let curvature = path.curvature_per_m(along_m);
        // Inside of a turn the way is shorter than along the path.
        let along_rate = speed_mps / (1.0 - curvature * left_m);
        let (sin, cos) = heading_rad.sin_cos();
        samples.push(Sample {
            pose: [
                place.x,
                place.y,
                heading_rad + yaw.0,
                pitch_rad + pitch.0,
                roll.0,
                height_m + up.0,
            ],
            rates: [
                speed_mps * cos - left.1 * sin,
                speed_mps * sin + left.1 * cos,
                curvature * along_rate + yaw.1,
                pitch.1,
                roll.1,
                up.1,
            ],
            travelled_m: speed_mps * time_s,
        });
        along_m += along_rate * STEP_S;
    }
    samples
}
