//! Exposure times and time stamps of cameras.

use tiepoint_geometry::Rng;

use crate::effects::ClockEffects;

/// The clock of a camera: stamp = (1 + drift) · time + offset, with the true time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clock {
    /// Reading at true time 0, in seconds.
    pub offset_s: f64,
    /// Relative error of its rate.
    pub drift: f64,
}

/// The clock of a camera and its exposures.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Schedule {
    pub(crate) clock: Clock,
    /// True time and time stamp of each exposure, in seconds.
    pub(crate) times_s: Vec<(f64, f64)>,
}

impl Clock {
    /// The reading at a true time.
    pub fn stamp_s(&self, time_s: f64) -> f64 {
        (1.0 + self.drift) * time_s + self.offset_s
    }

    /// The true time of a reading.
    pub fn time_s(&self, stamp_s: f64) -> f64 {
        (stamp_s - self.offset_s) / (1.0 + self.drift)
    }
}

/// Schedules the exposures of a camera: `rate_hz` per second of its own clock until `duration_s`.
/// The first camera is the time reference: its clock is exact and it starts immediately.
pub(crate) fn schedule(
    effects: &ClockEffects,
    is_first: bool,
    rate_hz: f64,
    duration_s: f64,
    rng: &mut Rng,
) -> Schedule {
    let scale = if is_first { 0.0 } else { 1.0 };
    let mut uniform_symmetric = |bound: f64| scale * bound * (2.0 * rng.uniform() - 1.0);
    let clock = Clock {
        offset_s: uniform_symmetric(effects.offset_s),
        drift: uniform_symmetric(effects.drift_ppm) * 1e-6,
    };
    let rate_hz = rate_hz * (1.0 + uniform_symmetric(effects.rate_spread));
    let start_s =
        scale * (effects.late_start_s * rng.uniform() + effects.phase * rng.uniform() / rate_hz);
    let period_s = 1.0 / (rate_hz * (1.0 + clock.drift));
    let mut times_s = Vec::new();
    for k in 0.. {
        let time_s = start_s + f64::from(k) * period_s;
        if time_s > duration_s {
            break;
        }
        let is_lost = rng.uniform() < effects.drop_fraction;
        let stamp_s = clock.stamp_s(time_s) + effects.jitter_s * rng.normal();
        if !is_lost {
            times_s.push((time_s, stamp_s));
        }
    }
    Schedule { clock, times_s }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Effects;
    use proptest::prelude::*;
    use tiepoint_geometry::Rng;

    proptest! {
        #[test]
        fn clock_conversions_are_inverse(
            offset_s in -100.0..100.0,
            drift in -1e-3..1e-3,
            time_s in 0.0..1e4,
        ) {
            let clock = Clock { offset_s, drift };
            prop_assert!((clock.time_s(clock.stamp_s(time_s)) - time_s).abs() < 1e-9);
        }

        #[test]
        fn stamps_are_those_of_the_clock(seed: u64) {
            let effects = Effects::all().clocks;
            let made = schedule(&effects, false, 30.0, 60.0, &mut Rng::stream(seed, &[]));
            prop_assert!(made.clock.offset_s.abs() <= effects.offset_s);
            prop_assert!(made.clock.drift.abs() <= effects.drift_ppm * 1e-6);
            // Bound of six standard deviations of the jitter.
            for &(time_s, stamp_s) in &made.times_s {
                prop_assert!((made.clock.stamp_s(time_s) - stamp_s).abs() < 6.0 * effects.jitter_s);
                prop_assert!((0.0..=60.0).contains(&time_s));
            }
            // 1 % of 1800 frames are lost, with six standard deviations of 4; the late start of up
            // to half a second and the rate, 0.2 % off, change the number by 18.6.
            prop_assert!(
                (1800 - 18 - 24 - 19..1800 + 4).contains(&made.times_s.len()),
                "{}",
                made.times_s.len()
            );
        }
    }

    #[test]
    fn cameras_are_synchronous_without_effects() {
        let times = |is_first, seed| {
            schedule(&ClockEffects::default(), is_first, 10.0, 5.05, &mut Rng::stream(seed, &[]))
        };
        assert_eq!(times(true, 1), times(false, 2));
        assert_eq!(times(true, 1).times_s.len(), 51);
        assert!(times(true, 1).times_s.iter().all(|(time, stamp)| time == stamp));
    }

    #[test]
    fn first_camera_is_the_time_reference() {
        let made = schedule(&Effects::all().clocks, true, 10.0, 5.0, &mut Rng::stream(1, &[]));
        assert_eq!(made.clock, Clock { offset_s: 0.0, drift: 0.0 });
        assert_eq!(made.times_s[0].0, 0.0);
    }
}
