//! One side of a street.

use tiepoint_pipeline::eval::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_synth::Drive;

/// The vehicle's way is looked at this often: it moves by a metre or two in between, and stands
/// tens of metres from what it passes.
const STEP_S: f64 = 0.2;

/// One side of the vehicle's way, or all of it.
pub(super) struct Side {
    /// Places, and the direction to that side.
    way: Vec<(Vector2<f64>, Vector2<f64>)>,
}

impl Side {
    /// Everything.
    pub(super) fn both() -> Self {
        Self { way: Vec::new() }
    }

    /// To the right of the vehicle.
    pub(super) fn right(drive: &Drive) -> Self {
        Self::of(drive, 1.0)
    }

    /// To its left.
    pub(super) fn left(drive: &Drive) -> Self {
        Self::of(drive, -1.0)
    }

    fn of(drive: &Drive, sign: f64) -> Self {
        let trajectory = drive.trajectory();
        let steps = (trajectory.duration_s() / STEP_S) as usize;
        let place = |step: usize| {
            let world_from_vehicle = trajectory.world_from_vehicle(step as f64 * STEP_S);
            let aside = world_from_vehicle.rotation * Vector3::new(sign, 0.0, 0.0);
            (world_from_vehicle.translation.xy(), aside.xy())
        };
        Self { way: (0..=steps).map(place).collect() }
    }

    /// Whether a point is on that side where the vehicle passed it nearest.
    pub(super) fn has(&self, point: &Vector3<f64>) -> bool {
        let off = |place: &(Vector2<f64>, Vector2<f64>)| (point.xy() - place.0).norm_squared();
        let nearest = self.way.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        nearest.is_none_or(|(place, aside)| aside.dot(&(point.xy() - place)) > 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiepoint_synth::DriveOptions;

    /// Beside the vehicle, in metres: nearer than the next street.
    const BESIDE_M: f64 = 6.0;

    #[test]
    fn points_beside_the_vehicle_are_on_their_side() {
        let drive = Drive::new(&DriveOptions::default()).unwrap();
        let trajectory = drive.trajectory();
        for k in 0..20 {
            let place =
                trajectory.world_from_vehicle(f64::from(k) * trajectory.duration_s() / 20.0);
            for sign in [1.0, -1.0] {
                let point = place * Vector3::new(sign * BESIDE_M, -1.0, 0.0);
                assert_eq!(Side::right(&drive).has(&point), sign > 0.0);
                assert_eq!(Side::left(&drive).has(&point), sign < 0.0);
                assert!(Side::both().has(&point));
            }
        }
    }
}
