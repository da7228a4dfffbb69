//! The vehicle model: a kinematic bicycle, steered along the route by a driver model, with a
//! suspension on an uneven road.
//!
//! The state is integrated by the Runge-Kutta method of order 4 at 1 kHz; the commands of the
//! driver are constant within a step.
//! - Bicycle (rear axle): ẋ = v cos ψ, ẏ = v sin ψ, ψ̇ = v tan δ / L, with first-order lags of the
//!   steering angle and the acceleration.
//! - Steering: pure pursuit (Coulter 1992) of a lane with a slow random lateral deviation.
//! - Speed: limited by the curvature ahead, the next stop and a slow variation.
//! - Body: damped springs for pitch, roll and heave, excited by acceleration and by the road under
//!   the axles.

use tiepoint_geometry::{Rng, nalgebra::SVector};

use super::motion::Motion;
use super::sample::{STEP_S, Sample};
use crate::route::{Route, RoutePosition};

/// Distance between the axles, in metres.
const WHEELBASE_M: f64 = 2.7;
/// Time constants of the steering and the acceleration, in seconds.
const STEERING_LAG_S: f64 = 0.15;
const THROTTLE_LAG_S: f64 = 0.25;
/// Limits of longitudinal and lateral acceleration, in m/s²: a comfortable ride.
const MAX_ACCELERATION: f64 = 1.8;
const MAX_BRAKING: f64 = 2.5;
const MAX_LATERAL: f64 = 2.5;
/// Natural frequency (rad/s) and damping ratio of the body of a family car.
const BODY_OMEGA: f64 = 1.3 * std::f64::consts::TAU;
const BODY_DAMPING: f64 = 0.35;
/// Pitch and roll per acceleration, in radians per m/s² (0.4 and 0.5 degrees).
const PITCH_PER_ACCELERATION: f64 = 0.007;
const ROLL_PER_ACCELERATION: f64 = 0.009;
/// Waves of the road: wavelength and amplitude, in metres.
const ROAD_WAVES_M: [(f64, f64); 6] =
    [(23.0, 0.010), (11.0, 0.006), (5.3, 0.003), (2.9, 0.0020), (1.7, 0.0012), (0.9, 0.0006)];
/// Lateral deviation of the driver from the lane and its wavelengths, in metres.
const WANDER_M: f64 = 0.12;
const WANDER_WAVELENGTHS_M: [f64; 3] = [71.0, 43.0, 29.0];

/// x, y, yaw, speed, acceleration, steering angle, travelled distance, then value and rate of
/// pitch, roll and heave (metres, radians, seconds).
type State = SVector<f64, 13>;
const X: usize = 0;
const Y: usize = 1;
const YAW: usize = 2;
const SPEED: usize = 3;
const ACCELERATION: usize = 4;
const STEERING: usize = 5;
const TRAVELLED: usize = 6;
const PITCH: usize = 7;
const ROLL: usize = 9;
const HEAVE: usize = 11;

/// The command of the driver during one step.
#[derive(Clone, Copy)]
struct Command {
    acceleration: f64,
    steering_rad: f64,
}

/// The vehicle with the phases of the waves of the road.
struct Car {
    road_phases: [f64; 6],
}

impl Car {
    /// Height of the road and its slope along the route at a travelled distance.
    fn road(&self, travelled_m: f64) -> (f64, f64) {
        let mut sums = (0.0, 0.0);
        for (&(wavelength, amplitude), phase) in ROAD_WAVES_M.iter().zip(self.road_phases) {
            let k = std::f64::consts::TAU / wavelength;
            let (sin, cos) = (k * travelled_m + phase).sin_cos();
            sums = (sums.0 + amplitude * sin, sums.1 + amplitude * k * cos);
        }
        sums
    }

    fn derivative(&self, state: &State, command: Command) -> State {
        let [yaw, speed, acceleration] = [state[YAW], state[SPEED], state[ACCELERATION]];
        let yaw_rate = speed * state[STEERING].tan() / WHEELBASE_M;
        let mut rate = State::zeros();
        rate[X] = speed * yaw.cos();
        rate[Y] = speed * yaw.sin();
        rate[YAW] = yaw_rate;
        // Brakes stop the car but do not accelerate it backwards.
        rate[SPEED] = if speed <= 0.0 { acceleration.max(0.0) } else { acceleration };
        rate[ACCELERATION] = (command.acceleration - acceleration) / THROTTLE_LAG_S;
        rate[STEERING] = (command.steering_rad - state[STEERING]) / STEERING_LAG_S;
        rate[TRAVELLED] = speed;
        let (rear, rear_slope) = self.road(state[TRAVELLED]);
        let (front, front_slope) = self.road(state[TRAVELLED] + WHEELBASE_M);
        // Pseudo-random height for the roll: the road at an unrelated distance.
        let (roll_height, _) = self.road(1.31 * state[TRAVELLED] + 7.0);
        let targets = [
            (PITCH, PITCH_PER_ACCELERATION * rate[SPEED] + (front - rear) / WHEELBASE_M, 0.0),
            (ROLL, ROLL_PER_ACCELERATION * speed * yaw_rate + 0.3 * roll_height, 0.0),
            (HEAVE, 0.5 * (front + rear), 0.5 * speed * (front_slope + rear_slope)),
        ];
        for (value, target, target_rate) in targets {
            let velocity = state[value + 1];
            rate[value] = velocity;
            rate[value + 1] = BODY_OMEGA * BODY_OMEGA * (target - state[value])
                + 2.0 * BODY_DAMPING * BODY_OMEGA * (target_rate - velocity);
        }
        rate
    }

    fn step(&self, state: &State, command: Command) -> State {
        let k1 = self.derivative(state, command);
        let k2 = self.derivative(&(state + k1 * (0.5 * STEP_S)), command);
        let k3 = self.derivative(&(state + k2 * (0.5 * STEP_S)), command);
        let k4 = self.derivative(&(state + k3 * STEP_S), command);
        let mut next = state + (k1 + (k2 + k3) * 2.0 + k4) * (STEP_S / 6.0);
        next[SPEED] = next[SPEED].max(0.0);
        next
    }
}

/// The driver model.
struct Driver<'a> {
    route: &'a Route,
    motion: &'a Motion,
    /// Travelled distances of the stops, in metres; the next one is last.
    stops_m: Vec<f64>,
    stopped_s: f64,
    phases: [f64; 6],
    /// Arc length of the nearest point of the route; increases over laps.
    along_m: f64,
}

impl Driver<'_> {
    /// Highest speed for the curvature ahead, with a slow variation.
    fn max_speed_mps(&self) -> f64 {
        let speed_factor = 0.9 + 0.1 * (self.along_m / 37.0 + self.phases[0]).sin();
        let mut speed = self.motion.speed_mps * speed_factor;
        let look_ahead_m = self.motion.speed_mps.powi(2) / (2.0 * MAX_BRAKING) + 2.0;
        let mut ahead = 0.0;
        while ahead < look_ahead_m {
            let curvature = self.route.curvature_per_m(self.along_m + ahead).abs();
            let curve_speed2 = MAX_LATERAL / curvature.max(1e-6);
            speed = speed.min((curve_speed2 + 2.0 * 0.7 * MAX_BRAKING * ahead).sqrt());
            ahead += 1.0;
        }
        speed
    }

    fn command(&mut self, state: &State) -> Command {
        let position = tiepoint_geometry::nalgebra::Vector2::new(state[X], state[Y]);
        // One Newton step per millisecond tracks the nearest point of the route: the car moves by
        // millimetres.
        let heading = self.route.heading_rad(self.along_m);
        let offset = position - self.route.point(self.along_m);
        let along = offset.x * heading.cos() + offset.y * heading.sin();
        let left = offset.y * heading.cos() - offset.x * heading.sin();
        self.along_m += along / (1.0 - self.route.curvature_per_m(self.along_m) * left).max(0.2);

        let speed = state[SPEED];
        let mut target_speed = self.max_speed_mps();
        let mut acceleration = None;
        if let Some(&stop) = self.stops_m.last() {
            let remaining_m = stop - state[TRAVELLED];
            target_speed =
                target_speed.min((2.0 * 0.7 * MAX_BRAKING * remaining_m.max(0.0)).sqrt());
            if remaining_m < 1.0 && speed < 0.3 {
                acceleration = Some(-speed / 0.2);
                self.stopped_s += STEP_S;
                if self.stopped_s > self.motion.stop_duration_s {
                    self.stops_m.pop();
                    self.stopped_s = 0.0;
                }
            }
        }
        let acceleration = acceleration.unwrap_or_else(|| {
            (1.5 * (target_speed - speed)).clamp(-MAX_BRAKING, MAX_ACCELERATION)
        });

        let look_ahead = 4.0 + 0.35 * speed;
        let along_m = self.along_m + look_ahead;
        let mut left_m = self.motion.lane_left_m;
        for (wavelength, phase) in WANDER_WAVELENGTHS_M.iter().zip(&self.phases[1..]) {
            left_m += WANDER_M / 2.0 * (std::f64::consts::TAU * along_m / wavelength + phase).sin();
        }
        let target = self.route.point_beside(RoutePosition { along_m, left_m }) - position;
        let (sin, cos) = state[YAW].sin_cos();
        let (forward, sideways) =
            (target.x * cos + target.y * sin, target.y * cos - target.x * sin);
        let distance2 = forward * forward + sideways * sideways;
        Command { acceleration, steering_rad: (2.0 * WHEELBASE_M * sideways / distance2).atan() }
    }
}

/// Simulates until the car has passed `distance_m` of the route, or for an hour: samples at 1 kHz.
pub(super) fn drive(route: &Route, motion: &Motion, distance_m: f64, rng: &mut Rng) -> Vec<Sample> {
    let mut phase = || std::f64::consts::TAU * rng.uniform();
    let car = Car { road_phases: std::array::from_fn(|_| phase()) };
    let phases = std::array::from_fn(|_| phase());
    // Stops are at random places around equal fractions of the distance, away from its ends.
    let share = distance_m / (motion.stops + 1) as f64;
    let mut stops_m: Vec<f64> =
        (1..=motion.stops).map(|k| share * (k as f64 + 0.4 * (rng.uniform() - 0.5))).collect();
    stops_m.reverse();
    let mut driver = Driver { route, motion, stops_m, stopped_s: 0.0, phases, along_m: 0.0 };
    let start = route.point_beside(RoutePosition { along_m: 0.0, left_m: motion.lane_left_m });
    let mut state = State::zeros();
    (state[X], state[Y], state[YAW]) = (start.x, start.y, route.heading_rad(0.0));
    state[SPEED] = driver.max_speed_mps();
    // The suspension starts at the height of the road, so that the drive does not begin with a
    // jolt.
    (state[HEAVE], _) = car.road(0.0);
    let max_steps = (3600.0 / STEP_S) as usize;
    let mut samples = vec![Sample::from(&state)];
    while driver.along_m < distance_m && samples.len() < max_steps {
        let command = driver.command(&state);
        state = car.step(&state, command);
        samples.push(Sample::from(&state));
    }
    samples
}

impl From<&State> for Sample {
    fn from(state: &State) -> Self {
        let speed = state[SPEED];
        Self {
            pose: [X, Y, YAW, PITCH, ROLL, HEAVE].map(|channel| state[channel]),
            rates: [
                speed * state[YAW].cos(),
                speed * state[YAW].sin(),
                speed * state[STEERING].tan() / WHEELBASE_M,
                state[PITCH + 1],
                state[ROLL + 1],
                state[HEAVE + 1],
            ],
            travelled_m: state[TRAVELLED],
        }
    }
}
