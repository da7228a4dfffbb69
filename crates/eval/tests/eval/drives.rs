//! Surface errors and relative-pose series with known results.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use tiepoint_eval::{
    PosePair, TrueObservation, relative_pose_series, surface_errors, triangulate_true_observations,
};
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::{Rigid3, Rng};

/// Roundings of some tens of operations on numbers of size 10.
const TOLERANCE: f64 = 1e-9;

fn vector(rng: &mut Rng, scale: f64) -> Vector3<f64> {
    Vector3::new(rng.normal(), rng.normal(), rng.normal()) * scale
}

fn true_observation(camera: Vector3<f64>, surface: Option<Vector3<f64>>) -> TrueObservation {
    TrueObservation { camera_in_world: camera, surface_in_world: surface }
}

#[test]
fn surface_error_is_the_median_over_static_observations() {
    let eye = Vector3::zeros();
    let wall = |x: f64| true_observation(eye, Some(Vector3::new(x, 0.0, 10.0)));
    let sky = true_observation(eye, None);
    let point = Vector3::new(0.0, 0.0, 10.0);
    for (true_observations, expected) in [
        // Three agree; the fourth is behind an edge.
        (vec![wall(0.1), wall(0.2), wall(0.3), wall(50.0)], Some(0.2)),
        (vec![wall(0.1), wall(9.0)], Some(0.1)),
        (vec![wall(0.1), sky], Some(0.1)),
        (vec![wall(0.1), sky, sky], None),
        (vec![sky, sky], None),
        (vec![], None),
    ] {
        let error = surface_errors(&[point], std::slice::from_ref(&true_observations))[0];
        match (error, expected) {
            (Some(error), Some(expected)) => {
                assert!((error.distance - expected).abs() < TOLERANCE, "{true_observations:?}");
                assert!((error.range - 10.0).abs() < 0.01, "{true_observations:?}");
            }
            (error, expected) => {
                assert_eq!(error.is_some(), expected.is_some(), "{true_observations:?}")
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64,
        failure_persistence: None,
        ..Default::default()
    })]

    /// Intersecting rays give their common point. For other rays no point nearby has a smaller sum
    /// of squared angles.
    #[test]
    fn triangulation_minimises_squared_angles(
        seed: u64,
        count in 2..6usize,
        noise in prop::sample::select(vec![0.0, 0.05]),
    ) {
        let mut rng = Rng::stream(seed, &[]);
        let point = vector(&mut rng, 5.0);
        let true_observations: Vec<TrueObservation> = (0..count)
            .map(|_| {
                let camera = vector(&mut rng, 10.0);
                let seen = point + vector(&mut rng, noise);
                // The surface lies at the point or behind it: only the direction counts.
                true_observation(camera, Some(seen + (seen - camera) * noise))
            })
            .collect();
        let cost = |at: &Vector3<f64>| -> f64 {
            let square = |s: &TrueObservation| {
                let ray = s.surface_in_world.unwrap() - s.camera_in_world;
                let across = ray.cross(&(at - s.camera_in_world)).norm() / ray.norm();
                (across / ray.norm()).powi(2)
            };
            true_observations.iter().map(square).sum()
        };
        let tracks = std::slice::from_ref(&true_observations);
        let Some(found) = triangulate_true_observations(tracks)[0] else {
            return Err(TestCaseError::reject("parallel rays"));
        };
        if noise == 0.0 {
            // Directions 0.1 rad apart leave eight digits of ten.
            prop_assert!((found - point).norm() < 1e-6, "{found} {point}");
        }
        for _ in 0..20 {
            let step = vector(&mut rng, 1e-3);
            prop_assert!(cost(&found) <= cost(&(found + step)) + 1e-15);
        }
    }

    /// The relative poses of a rigid rig have no variation and no drift.
    #[test]
    fn rigid_rig_has_no_variation(seed: u64, count in 2..20usize) {
        let mut rng = Rng::stream(seed, &[]);
        let rig = Rigid3::from_axis_angle(vector(&mut rng, 1.0), vector(&mut rng, 1.0));
        let pairs: Vec<PosePair> = (0..count)
            .map(|k| {
                let left = Rigid3::from_axis_angle(vector(&mut rng, 1.0), vector(&mut rng, 10.0));
                PosePair { time_s: k as f64, left_from_world: left, right_from_world: rig * left }
            })
            .collect();
        let found = relative_pose_series(&pairs).unwrap();
        prop_assert!((found.right_from_left.translation - rig.translation).norm() < TOLERANCE);
        prop_assert!(found.right_from_left.rotation.angle_to(&rig.rotation) < 1e-7);
        prop_assert!((found.baseline.mean - rig.translation.norm()).abs() < TOLERANCE);
        for zero in [
            found.baseline.std, found.translation_rms, found.rotation_rms_rad, found.baseline_drift,
            found.translation_drift, found.rotation_drift_rad,
        ] {
            // Against a baseline of about 1.
            prop_assert!(zero.abs() < 1e-7 / found.baseline.mean.min(1.0), "{found:?}");
        }
    }
}

#[test]
fn drift_is_the_change_of_a_linear_fit() {
    const COUNT: usize = 11;
    // The baseline grows from 1 to 2, and the right camera turns from −0.1 to 0.1 rad; times are
    // uneven.
    let pair = |k: usize| {
        let part = k as f64 / (COUNT - 1) as f64;
        let turn = Vector3::new(0.0, 0.2 * part - 0.1, 0.0);
        let left_from_right = Rigid3::from_axis_angle(turn, Vector3::new(1.0 + part, 0.0, 0.0));
        PosePair {
            time_s: 5.0 + 3.0 * part,
            left_from_world: Rigid3::identity(),
            right_from_world: left_from_right.inverse(),
        }
    };
    let found = relative_pose_series(&(0..COUNT).map(pair).collect::<Vec<_>>()).unwrap();
    assert!((found.baseline_drift - 1.0 / 1.5).abs() < TOLERANCE, "{found:?}");
    assert!((found.translation_drift - 1.0).abs() < TOLERANCE);
    assert!((found.rotation_drift_rad - 0.2).abs() < TOLERANCE);
    // Eleven even steps from −1/2 to 1/2 have the variance (11² − 1) / 12 / 10².
    let expected = (120.0f64 / 12.0).sqrt() / 10.0;
    assert!((found.translation_rms - expected).abs() < TOLERANCE);
    assert!((found.rotation_rms_rad - 0.2 * expected).abs() < TOLERANCE);
    assert!(relative_pose_series(&[pair(0)]).is_none());
}
