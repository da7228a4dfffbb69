//! Options of the motion of the cameras.

/// What carries the cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// A car in its lane.
    Car,
    /// A person who walks on the pavement: head bob, and slow turns of yaw and pitch.
    Handheld,
    /// A drone above the roofs that looks obliquely down, on parallel strips to and fro.
    Drone,
}

impl Carrier {
    /// All carriers.
    pub const ALL: [Self; 3] = [Self::Car, Self::Handheld, Self::Drone];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Car => "car",
            Self::Handheld => "handheld",
            Self::Drone => "drone",
        }
    }
}

/// Options of the motion of the cameras.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// What carries the cameras.
    pub carrier: Carrier,
    /// Cruising speed, in m/s.
    pub speed_mps: f64,
    /// Number of stops of a car.
    pub stops: usize,
    /// Duration of each stop, in seconds.
    pub stop_duration_s: f64,
    /// Lateral position of the lane of a car, in metres to the left of the centre line.
    pub lane_left_m: f64,
    /// On a loop, the distance in metres that the vehicle drives on after it has reached its start
    /// again, so that the beginning and the end of the drive see the same street.
    pub overlap_m: f64,
    /// Scale of the pitch, roll and heave of a car's body: 1 for a real car, 0 for none.
    pub suspension: f64,
    /// Amplitude of the 12 Hz vibration about each axis, in radians.
    pub vibration_rad: f64,
}

impl Motion {
    /// A carrier at its usual speed: 11 m/s of a car, 1.4 m/s of a pedestrian, 6 m/s of a drone.
    pub fn of(carrier: Carrier) -> Self {
        let speed_mps = match carrier {
            Carrier::Car => 11.0,
            Carrier::Handheld => 1.4,
            Carrier::Drone => 6.0,
        };
        Self { carrier, speed_mps, ..Self::default() }
    }

    /// A car on a highway: 24 to 30 m/s without stops.
    pub fn highway() -> Self {
        Self { speed_mps: 30.0, stops: 0, ..Self::default() }
    }
}

impl Default for Motion {
    /// A car: 11 m/s (25 mph) in the right lane with two stops, without pitch, roll, heave or
    /// vibration.
    fn default() -> Self {
        Self {
            carrier: Carrier::Car,
            speed_mps: 11.0,
            stops: 2,
            stop_duration_s: 3.0,
            lane_left_m: -1.75,
            overlap_m: 15.0,
            suspension: 0.0,
            vibration_rad: 0.0,
        }
    }
}
