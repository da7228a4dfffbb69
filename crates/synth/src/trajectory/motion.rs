//! Options of the motion of the vehicle.

/// Options of the motion of the vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Cruising speed, in m/s.
    pub speed_mps: f64,
    /// Number of stops.
    pub stops: usize,
    /// Duration of each stop, in seconds.
    pub stop_duration_s: f64,
    /// Lateral position of the lane, in metres to the left of the centre line.
    pub lane_left_m: f64,
    /// On a loop, the distance in metres that the vehicle drives on after it has reached its start
    /// again, so that the beginning and the end of the drive see the same street.
    pub overlap_m: f64,
    /// Scale of the pitch, roll and heave of the body: 1 for a real car, 0 for none.
    pub suspension: f64,
    /// Amplitude of the 12 Hz vibration about each axis, in radians.
    pub vibration_rad: f64,
}

impl Default for Motion {
    /// 11 m/s (25 mph) in the right lane with two stops, without pitch, roll, heave or vibration.
    fn default() -> Self {
        Self {
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
