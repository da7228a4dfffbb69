//! How a vehicle is to be driven.

/// How the vehicle is driven.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Cruising speed, in m/s.
    pub speed_mps: f64,
    /// How many times it stops on the way.
    pub stops: usize,
    /// How long each stop takes, in seconds.
    pub stop_duration_s: f64,
    /// The lane: metres to the left of the centre line.
    pub lane_left_m: f64,
    /// A loop is driven this much further than once round, so that its ends see the same, in
    /// metres.
    pub overlap_m: f64,
    /// How far body pitch, roll and heave go: 1 as a car's, 0 not at all.
    pub suspension: f64,
    /// Amplitude of the 12 Hz vibration about each axis, in radians.
    pub vibration_rad: f64,
}

impl Default for Motion {
    /// 25 mph in the right lane, two stops; the body still.
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
