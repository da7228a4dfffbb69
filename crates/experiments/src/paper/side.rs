//! One side of a street.

use tiepoint_pipeline::eval::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_synth::Drive;

/// Sampling interval of the trajectory: the vehicle moves by a metre or two in it.
const STEP_S: f64 = 0.2;

/// One side of the vehicle's trajectory, or both.
pub(crate) struct Side {
    /// Horizontal positions of the vehicle, and unit vectors to this side; empty for both sides.
    samples: Vec<(Vector2<f64>, Vector2<f64>)>,
}

impl Side {
    pub(crate) fn both() -> Self {
        Self { samples: Vec::new() }
    }

    /// To the right of the vehicle.
    pub(crate) fn right(drive: &Drive) -> Self {
        Self::of(drive, 1.0)
    }

    /// To the left of the vehicle.
    pub(crate) fn left(drive: &Drive) -> Self {
        Self::of(drive, -1.0)
    }

    /// The right side for `sign` = 1, the left side for −1.
    fn of(drive: &Drive, sign: f64) -> Self {
        let trajectory = drive.trajectory();
        let steps = (trajectory.duration_s() / STEP_S) as usize;
        let sample = |step: usize| {
            let world_from_vehicle = trajectory.world_from_vehicle(step as f64 * STEP_S);
            let aside = world_from_vehicle.rotation * Vector3::new(sign, 0.0, 0.0);
            (world_from_vehicle.translation.xy(), aside.xy())
        };
        Self { samples: (0..=steps).map(sample).collect() }
    }

    /// Whether a point is on this side of the nearest position of the vehicle.
    pub(crate) fn contains(&self, point: &Vector3<f64>) -> bool {
        let distance2 =
            |sample: &(Vector2<f64>, Vector2<f64>)| (point.xy() - sample.0).norm_squared();
        let nearest = self.samples.iter().min_by(|a, b| distance2(a).total_cmp(&distance2(b)));
        nearest.is_none_or(|(position, aside)| aside.dot(&(point.xy() - position)) > 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_synth::DriveOptions;

    /// Lateral distance of the test points, in metres: less than to the next street.
    const BESIDE_M: f64 = 6.0;

    #[test]
    fn points_beside_the_vehicle_are_assigned_to_their_side() {
        let drive = Drive::new(&DriveOptions::default()).unwrap();
        let trajectory = drive.trajectory();
        for k in 0..20 {
            let place =
                trajectory.world_from_vehicle(f64::from(k) * trajectory.duration_s() / 20.0);
            for sign in [1.0, -1.0] {
                let point = place * Vector3::new(sign * BESIDE_M, -1.0, 0.0);
                assert_eq!(Side::right(&drive).contains(&point), sign > 0.0);
                assert_eq!(Side::left(&drive).contains(&point), sign < 0.0);
                assert!(Side::both().contains(&point));
            }
        }
    }
}
