//! The trajectory of the vehicle: the dense output of its numerical integration.
//!
//! A car is integrated at 1 kHz (`vehicle`), a camera in a hand or on a drone sampled (`carried`).
//! Between two steps the pose is the cubic Hermite polynomial of values and rates, which is the
//! dense output of the integrator. A millisecond is far below the periods of all motions, so that
//! the interpolation is exact to well under a micrometre; it shares nothing with the splines that
//! estimators fit to image times.
//!
//! Frames: the world has x east, y north, z up; the vehicle, as cameras do, x right, y down, z
//! forward, with its origin on the road under the rear axle, or in the hand or the drone.

mod carried;
mod motion;
mod sample;
mod vehicle;

use tiepoint_geometry::nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use tiepoint_geometry::{Rigid3, Rng, so3};

use crate::error::{Error, require};
use crate::route::Route;
use carried::carry;
pub use motion::{Carrier, Motion};
use sample::{STEP_S, Sample};

/// Frequency of the engine vibration, and of the modulation of its amplitude.
const VIBRATION_HZ: f64 = 12.0;
const VIBRATION_BEAT_HZ: f64 = 0.37;

/// Linear and angular velocity of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Velocity {
    /// Velocity of the origin of the vehicle in world axes, in m/s.
    pub linear_in_world: Vector3<f64>,
    /// Angular velocity in vehicle axes, in rad/s.
    pub angular_in_vehicle: Vector3<f64>,
}

/// A simulated drive.
#[derive(Clone, Debug)]
pub struct Trajectory {
    samples: Vec<Sample>,
    suspension: f64,
    vibration_rad: f64,
    vibration_phases: [f64; 4],
}

impl Trajectory {
    /// Simulates a drive along a route from end to end, or once around a loop plus the overlap; of
    /// a drone, the flight over all of it.
    ///
    /// # Errors
    ///
    /// [`Error::OutOfRange`] if an option of the motion is out of its range.
    pub fn drive(route: &Route, motion: &Motion, rng: &mut Rng) -> Result<Self, Error> {
        require(
            (1.0..=40.0).contains(&motion.speed_mps),
            "speed_mps",
            motion.speed_mps,
            "1 to 40 m/s",
        )?;
        require(
            motion.stop_duration_s >= 0.0,
            "stop_duration_s",
            motion.stop_duration_s,
            "at least 0",
        )?;
        require(motion.lane_left_m.abs() <= 3.0, "lane_left_m", motion.lane_left_m, "-3 to 3 m")?;
        require(motion.overlap_m >= 0.0, "overlap_m", motion.overlap_m, "at least 0 m")?;
        let distance_m = route.length_m() + if route.is_closed() { motion.overlap_m } else { 0.0 };
        let samples = match motion.carrier {
            Carrier::Car => vehicle::drive(route, motion, distance_m, rng),
            Carrier::Handheld => {
                carry(route, &carried::HANDHELD, motion.speed_mps, distance_m, rng)
            }
            Carrier::Drone => {
                let strips = Route::strips_over(route)?;
                carry(&strips, &carried::DRONE, motion.speed_mps, strips.length_m(), rng)
            }
        };
        let is_car = motion.carrier == Carrier::Car;
        let vibration_phases = std::array::from_fn(|_| std::f64::consts::TAU * rng.uniform());
        Ok(Self {
            samples,
            suspension: if is_car { motion.suspension } else { 1.0 },
            vibration_rad: motion.vibration_rad,
            vibration_phases,
        })
    }

    /// Duration in seconds: poses are defined from 0 to it, and constant outside.
    pub fn duration_s(&self) -> f64 {
        (self.samples.len() - 1) as f64 * STEP_S
    }

    /// The samples before and after a time, and its fraction of the step between them, 0 to 1.
    fn bracketing_samples(&self, time_s: f64) -> (&Sample, &Sample, f64) {
        let steps = (time_s / STEP_S).clamp(0.0, (self.samples.len() - 1) as f64);
        let index = (steps as usize).min(self.samples.len().saturating_sub(2));
        (
            &self.samples[index],
            &self.samples[(index + 1).min(self.samples.len() - 1)],
            steps - index as f64,
        )
    }

    /// x, y, yaw, pitch, roll, heave and their rates.
    fn body(&self, time_s: f64) -> ([f64; 6], [f64; 6]) {
        let (before, after, u) = self.bracketing_samples(time_s);
        let (mut values, mut rates) = ([0.0; 6], [0.0; 6]);
        for k in 0..6 {
            (values[k], rates[k]) =
                hermite(before.pose[k], after.pose[k], before.rates[k], after.rates[k], u);
            if k >= 3 {
                values[k] *= self.suspension;
                rates[k] *= self.suspension;
            }
        }
        (values, rates)
    }

    /// Axis-angle vector of the vibration and its rate.
    fn vibration(&self, time_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let (omega, beat) =
            (std::f64::consts::TAU * VIBRATION_HZ, std::f64::consts::TAU * VIBRATION_BEAT_HZ);
        let (beat_sin, beat_cos) = (beat * time_s + self.vibration_phases[3]).sin_cos();
        let (strength, strength_rate) = (0.8 + 0.2 * beat_sin, 0.2 * beat * beat_cos);
        let (mut angle, mut rate) = (Vector3::zeros(), Vector3::zeros());
        for axis in 0..3 {
            let (sin, cos) = (omega * time_s + self.vibration_phases[axis]).sin_cos();
            angle[axis] = self.vibration_rad * strength * sin;
            rate[axis] = self.vibration_rad * (strength * omega * cos + strength_rate * sin);
        }
        (angle, rate)
    }

    /// world_from_vehicle at a time, in metres.
    pub fn world_from_vehicle(&self, time_s: f64) -> Rigid3 {
        let ([x, y, yaw, pitch, roll, heave], _) = self.body(time_s);
        let (vibration, _) = self.vibration(time_s);
        let rotation = level_rotation(yaw) * about_x(pitch) * about_z(roll) * so3::exp(&vibration);
        Rigid3::new(rotation, Vector3::new(x, y, heave))
    }

    /// Velocity at a time: the derivative of [`Trajectory::world_from_vehicle`].
    pub fn velocity(&self, time_s: f64) -> Velocity {
        let (values, rates) = self.body(time_s);
        let (vibration, vibration_rate) = self.vibration(time_s);
        // Yaw is about the z axis of the world, which is −y of the level vehicle. The rates of
        // pitch, roll and vibration are added in the order of the rotations.
        let in_pitched = about_x(values[3]).inverse() * Vector3::new(0.0, -rates[2], 0.0)
            + Vector3::x() * rates[3];
        let in_rolled = about_z(values[4]).inverse() * in_pitched + Vector3::z() * rates[4];
        let angular_in_vehicle = so3::exp(&vibration).inverse() * in_rolled
            + so3::left_jacobian(&vibration).transpose() * vibration_rate;
        Velocity { linear_in_world: Vector3::new(rates[0], rates[1], rates[5]), angular_in_vehicle }
    }

    /// Horizontal speed, in m/s.
    pub fn speed_mps(&self, time_s: f64) -> f64 {
        self.velocity(time_s).linear_in_world.xy().norm()
    }

    /// Distance travelled since the beginning, in metres.
    pub fn travelled_m(&self, time_s: f64) -> f64 {
        let (before, after, u) = self.bracketing_samples(time_s);
        before.travelled_m + u * (after.travelled_m - before.travelled_m)
    }
}

/// Value and rate of the cubic Hermite polynomial through two values with given rates, at the
/// fraction `u` of a step.
fn hermite(value0: f64, value1: f64, rate0: f64, rate1: f64, u: f64) -> (f64, f64) {
    let (slope0, slope1, rise) = (rate0 * STEP_S, rate1 * STEP_S, value1 - value0);
    let (c, d) = (3.0 * rise - 2.0 * slope0 - slope1, slope0 + slope1 - 2.0 * rise);
    (value0 + u * (slope0 + u * (c + u * d)), (slope0 + u * (2.0 * c + 3.0 * u * d)) / STEP_S)
}

/// The rotation world_from_vehicle of a level vehicle (right, down, forward).
fn level_rotation(yaw: f64) -> UnitQuaternion<f64> {
    let (sin, cos) = yaw.sin_cos();
    let axes = Matrix3::new(sin, 0.0, cos, -cos, 0.0, sin, 0.0, -1.0, 0.0);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}

fn about_x(angle: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle)
}

fn about_z(angle: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SEEDS: std::ops::Range<u64> = 0..4;

    fn drives() -> impl Iterator<Item = (Route, Trajectory)> {
        SEEDS.map(|seed| {
            let mut rng = Rng::stream(seed, &[7]);
            let route = if seed % 2 == 0 {
                Route::street_loop(260.0, &mut rng)
            } else {
                Route::open_street(260.0, &mut rng)
            };
            let route = route.unwrap();
            let motion = Motion {
                suspension: 1.0,
                vibration_rad: 0.05f64.to_radians(),
                ..Motion::default()
            };
            let trajectory = Trajectory::drive(&route, &motion, &mut rng).unwrap();
            (route, trajectory)
        })
    }

    fn carried() -> impl Iterator<Item = (Route, Trajectory)> {
        [Carrier::Handheld, Carrier::Drone].into_iter().zip(SEEDS).map(|(carrier, seed)| {
            let mut rng = Rng::stream(seed, &[8]);
            let route = Route::street_loop(200.0, &mut rng).unwrap();
            let motion = Motion { vibration_rad: 0.05f64.to_radians(), ..Motion::of(carrier) };
            let trajectory = Trajectory::drive(&route, &motion, &mut rng).unwrap();
            (route, trajectory)
        })
    }

    #[test]
    fn velocity_is_the_derivative_of_the_pose() {
        // Central differences of step h: truncation h²/6 · |pose'''| ≈ (1e-4)²/6 · 0.05° · (75/s)³
        // ≈ 1e-6 rad/s.
        const H_S: f64 = 1e-4;
        const TOLERANCE: f64 = 1e-5;
        for (_, trajectory) in drives().chain(carried()) {
            for k in 1..200 {
                // In the middle of a step: a difference across two steps would see the jump of the
                // third derivative.
                let time = (trajectory.duration_s() * k as f64 / 200.0 / STEP_S).floor() * STEP_S
                    + 0.5 * STEP_S;
                let (before, after) = (
                    trajectory.world_from_vehicle(time - H_S),
                    trajectory.world_from_vehicle(time + H_S),
                );
                let velocity = trajectory.velocity(time);
                let linear = (after.translation - before.translation) / (2.0 * H_S);
                assert!(
                    (linear - velocity.linear_in_world).norm() < TOLERANCE,
                    "{linear} {velocity:?}"
                );
                let angular = so3::log(&(before.rotation.inverse() * after.rotation)) / (2.0 * H_S);
                assert!(
                    (angular - velocity.angular_in_vehicle).norm() < TOLERANCE,
                    "{angular} {velocity:?}"
                );
            }
        }
    }

    #[test]
    fn pose_and_velocity_are_continuous_across_steps() {
        // 1 ns before and after a step: at 40 m/s² and 20 rad/s² nothing changes by more than this.
        const DT_S: f64 = 1e-9;
        const TOLERANCE: f64 = 1e-6;
        for (_, trajectory) in drives().chain(carried()) {
            for k in 1..500 {
                let step = (trajectory.duration_s() / STEP_S * k as f64 / 500.0).floor() * STEP_S;
                let (before, after) =
                    (trajectory.velocity(step - DT_S), trajectory.velocity(step + DT_S));
                assert!((before.linear_in_world - after.linear_in_world).norm() < TOLERANCE);
                assert!((before.angular_in_vehicle - after.angular_in_vehicle).norm() < TOLERANCE);
            }
        }
    }

    #[test]
    fn the_car_stays_in_its_lane_stops_and_arrives() {
        // Pure pursuit cuts corners; the lane is 3.5 m wide and the car 1.8 m.
        const MAX_OFF_LANE_M: f64 = 0.85;
        for (route, trajectory) in drives() {
            let (mut slowest, mut off_lane, mut hardest) = (f64::INFINITY, 0.0f64, 0.0f64);
            let samples = (trajectory.duration_s() / 0.05) as usize;
            for k in 0..samples {
                let time = k as f64 * 0.05;
                let position = route.locate(trajectory.world_from_vehicle(time).translation.xy());
                off_lane = off_lane.max((position.left_m - Motion::default().lane_left_m).abs());
                slowest = slowest.min(trajectory.speed_mps(time));
                hardest = hardest.max(
                    (trajectory.speed_mps(time + 0.05) - trajectory.speed_mps(time)).abs() / 0.05,
                );
            }
            assert!(off_lane < MAX_OFF_LANE_M, "{off_lane} m off the lane");
            assert!(slowest < 0.05, "never stopped: {slowest} m/s");
            assert!(hardest < 3.0, "{hardest} m/s²");
            let travelled = trajectory.travelled_m(trajectory.duration_s());
            assert!((travelled - route.length_m()).abs() < 0.15 * route.length_m(), "{travelled}");
        }
    }

    #[test]
    fn a_pedestrian_walks_on_the_pavement_and_a_drone_flies_over_the_whole_street() {
        // Half an image of the drone is wider than this to each side.
        const SEEN_M: f64 = 15.0;
        let [(street, walk), (block, flight)] = carried().collect::<Vec<_>>().try_into().unwrap();
        let poses = |trajectory: &Trajectory| -> Vec<Rigid3> {
            let samples = (trajectory.duration_s() / 0.05) as usize;
            (0..samples).map(|k| trajectory.world_from_vehicle(0.05 * k as f64)).collect()
        };
        for (k, pose) in poses(&walk).iter().enumerate() {
            let position = street.locate(pose.translation.xy());
            assert!((7.1..7.7).contains(&-position.left_m), "{position:?}");
            assert!((1.45..1.75).contains(&pose.translation.z), "{pose:?}");
            // The bob and the sway of 0.1 m are slower than 0.3 m/s.
            let velocity = walk.velocity(0.05 * k as f64).linear_in_world;
            assert!((velocity.norm() - 1.4).abs() < 0.3, "{velocity}");
            // Waves of yaw together have 0.23 rad.
            let ahead = street.heading_rad(position.along_m);
            let view = pose.rotation * Vector3::z();
            assert!(view.x * ahead.cos() + view.y * ahead.sin() > 0.3f64.cos(), "{view}");
        }
        let flight = poses(&flight);
        for pose in &flight {
            let (height, down) = (pose.translation.z, (pose.rotation * Vector3::z()).z);
            assert!((29.0..39.0).contains(&height) && (-0.9..-0.65).contains(&down), "{pose:?}");
        }
        for k in 0..block.length_m() as usize {
            let place = block.point(k as f64);
            let seen = flight.iter().any(|pose| (pose.translation.xy() - place).norm() < SEEN_M);
            assert!(seen, "nobody flies over {place}");
        }
    }

    #[test]
    fn a_rigid_car_stays_level() {
        let mut rng = Rng::stream(3, &[]);
        let route = Route::street_loop(200.0, &mut rng).unwrap();
        let trajectory = Trajectory::drive(&route, &Motion::default(), &mut rng).unwrap();
        for k in 0..100 {
            let pose = trajectory.world_from_vehicle(0.2 * k as f64);
            let down = pose.rotation * Vector3::y();
            assert!((down + Vector3::z()).norm() < 1e-12 && pose.translation.z == 0.0);
        }
    }
}
