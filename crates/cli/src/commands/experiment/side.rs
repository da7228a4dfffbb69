//! One side of a street.

use rayon::prelude::*;
use tiepoint_pipeline::eval::geometry::nalgebra::{Vector2, Vector3};
use tiepoint_synth::Drive;

/// The vehicle's way is looked at this often: it moves by a metre or two in between, and stands tens of metres from what it passes.
const STEP_S: f64 = 0.2;

/// The points on one side of the vehicle where it passed nearest: to its right (`side` 1) or left (−1).
pub(super) fn beside_the_way(drive: &Drive, scan: Vec<Vector3<f64>>, side: f64) -> Vec<Vector3<f64>> {
    let trajectory = drive.trajectory();
    let steps = (trajectory.duration_s() / STEP_S) as usize;
    let way: Vec<(Vector2<f64>, Vector2<f64>)> = (0..=steps)
        .map(|step| {
            let world_from_vehicle = trajectory.world_from_vehicle(step as f64 * STEP_S);
            let right = world_from_vehicle.rotation * Vector3::x();
            (world_from_vehicle.translation.xy(), right.xy())
        })
        .collect();
    let is_there = |point: &Vector3<f64>| {
        let off = |place: &(Vector2<f64>, Vector2<f64>)| (point.xy() - place.0).norm_squared();
        let nearest = way.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        nearest.is_some_and(|(place, right)| side * right.dot(&(point.xy() - place)) > 0.0)
    };
    scan.into_par_iter().filter(is_there).collect()
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
        let points = |side: f64| -> Vec<Vector3<f64>> {
            let places =
                (0..20).map(|k| trajectory.world_from_vehicle(f64::from(k) * trajectory.duration_s() / 20.0));
            places.map(|place| place * Vector3::new(side * BESIDE_M, -1.0, 0.0)).collect()
        };
        let both: Vec<Vector3<f64>> = points(1.0).into_iter().chain(points(-1.0)).collect();
        for side in [1.0, -1.0] {
            assert_eq!(beside_the_way(&drive, both.clone(), side), points(side));
        }
    }
}
