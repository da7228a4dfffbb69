//! The baseline factor against numbers: its Jacobian, its zero, its branch near π, and the weights
//! of Eq. (2) and (4).

use proptest::prelude::*;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::{Rigid3, so3};
use tiepoint_rig::ba::testing::check_jacobians;
use tiepoint_rig::{
    Baseline, RelativePose, SynchronousExtrinsics, paper, relative_pose_statistics, robust_average,
};

/// Numeric differentiation with steps near the cube root of machine precision, on numbers up to
/// about 10 and weights of √500.
const JACOBIAN_TOLERANCE: f64 = 1e-5;

fn vector(limit: f64) -> impl Strategy<Value = Vector3<f64>> {
    [-limit..limit, -limit..limit, -limit..limit].prop_map(|[x, y, z]| Vector3::new(x, y, z))
}

fn pose() -> impl Strategy<Value = Rigid3> {
    (vector(1.8), vector(5.0)).prop_map(|(w, t)| Rigid3::from_axis_angle(w, t))
}

/// A drive of two moments: two rig poses, one mounting with a small change between the moments.
fn moments(mounting: impl Strategy<Value = Vector3<f64>>) -> impl Strategy<Value = [Rigid3; 4]> {
    (pose(), pose(), mounting, vector(1.0), vector(0.05), vector(0.05)).prop_map(
        |(left, next_left, w, t, dw, dt)| {
            let right_from_left = Rigid3::from_axis_angle(w, t);
            let next_right_from_left =
                Rigid3::new(so3::exp(&dw) * right_from_left.rotation, t + dt);
            [left, right_from_left * left, next_left, next_right_from_left * next_left]
        },
    )
}

fn near_pi() -> impl Strategy<Value = Vector3<f64>> {
    (vector(1.0), -0.02..0.02).prop_filter_map("an axis", |(axis, off)| {
        let axis = axis.try_normalize(0.1)?;
        Some(axis * (std::f64::consts::PI + off))
    })
}

fn check([a, b, c, d]: [Rigid3; 4]) {
    if let Err(difference) = check_jacobians(
        &Baseline::with_weight(paper::LAMBDA, RelativePose::between(&a, &b)),
        (a, b, c, d),
        JACOBIAN_TOLERANCE,
    ) {
        panic!("{difference}");
    }
}

proptest! {
    #[test]
    fn jacobian_for_any_mounting(m in moments(vector(1.5))) {
        check(m);
    }

    #[test]
    fn jacobian_for_cameras_that_look_in_opposite_directions(m in moments(near_pi())) {
        check(m);
    }

    #[test]
    fn jacobian_for_cameras_that_look_in_one_direction(m in moments(vector(1e-9))) {
        check(m);
    }

    #[test]
    fn a_rigid_rig_has_no_cost(left in pose(), next in pose(), w in near_pi(), t in vector(1.0)) {
        let rig = Rigid3::from_axis_angle(w, t);
        let now = RelativePose::between(&left, &(rig * left));
        let then = RelativePose::between(&next, &(rig * next)).nearest_to(&now);
        prop_assert!((now.to_vector() - then.to_vector()).norm() < 1e-9);
    }

    #[test]
    fn the_transform_comes_back(left in pose(), w in vector(1.5), t in vector(1.0)) {
        let rig = Rigid3::from_axis_angle(w, t);
        let back = RelativePose::between(&left, &(rig * left)).right_from_left();
        prop_assert!((back.translation - rig.translation).norm() < 1e-9);
        prop_assert!(back.rotation.angle_to(&rig.rotation) < 1e-7);
    }
}

fn p(t: f64, a: f64) -> RelativePose {
    RelativePose {
        translation: Vector3::new(t, 0.01, 0.02),
        axis_angle: Vector3::new(0.01, a, 0.01),
    }
}

#[test]
fn the_weight_grows_with_the_pairs() {
    assert_eq!(paper::growing_weight(3, 6), 250.0);
    assert_eq!(paper::growing_weight(6, 6), 500.0);
}

#[test]
fn a_pair_that_one_element_betrays_is_pulled_harder() {
    let mut poses = vec![p(0.5, 0.1); 20];
    poses[7] = p(0.5, -0.8);
    let weights = paper::final_link_weights(&poses);
    let expected: Vec<f64> =
        (0..19).map(|i| if i == 6 || i == 7 { 500.0 } else { 250.0 }).collect();
    assert_eq!(weights, expected);
}

#[test]
fn spread_of_a_drifting_baseline() {
    let poses: Vec<RelativePose> = (0..10).map(|i| p(if i < 5 { 0.5 } else { 0.4 }, 0.1)).collect();
    let spread = relative_pose_statistics(&poses).unwrap();
    assert!((spread.second_over_first_half - 0.8).abs() < 0.01);
    assert!(spread.rms_rotation_rad < 1e-9);
    assert!((spread.rms_translation - 0.05).abs() < 1e-12);
}

/// A rig at one moment, with some play against its calibration.
fn mounted(mounting: impl Strategy<Value = Vector3<f64>>) -> impl Strategy<Value = [Rigid3; 3]> {
    (pose(), mounting, vector(1.0), vector(0.2), vector(0.2)).prop_filter_map(
        "a baseline",
        |(left, w, t, dw, dt)| {
            let mount = Rigid3::from_axis_angle(w, t);
            let right_from_left = Rigid3::new(so3::exp(&dw) * mount.rotation, t + dt);
            (t.norm() > 0.2).then_some([left, right_from_left * left, mount])
        },
    )
}

fn check_mounted([left, right, mount]: [Rigid3; 3]) {
    for assumed_baseline in [None, Some(0.7)] {
        let factor = SynchronousExtrinsics {
            sigma_translation: 0.05,
            sigma_rotation_rad: 0.02,
            assumed_baseline,
        };
        if let Err(difference) = check_jacobians(&factor, (left, right, mount), JACOBIAN_TOLERANCE)
        {
            panic!("{assumed_baseline:?}: {difference}");
        }
    }
}

/// Rounding of numbers of about 10, times the weights.
const ZERO: f64 = 1e-10;

proptest! {
    #[test]
    fn mounting_jacobian_for_any(m in mounted(vector(1.5))) {
        check_mounted(m);
    }

    #[test]
    fn mounting_jacobian_for_cameras_that_look_in_opposite_directions(m in mounted(near_pi())) {
        check_mounted(m);
    }

    #[test]
    fn mounting_jacobian_for_cameras_that_look_in_one_direction(m in mounted(vector(1e-9))) {
        check_mounted(m);
    }

    /// The size of a model is its own affair: scaled with its mounting, nothing changes.
    #[test]
    fn a_mounting_does_not_see_scale(
        [left, right, mount] in mounted(vector(1.0)),
        scale in 0.01..100.0,
    ) {
        use tiepoint_rig::ba::Factor;
        let factor = SynchronousExtrinsics {
            sigma_translation: 0.05,
            sigma_rotation_rad: 0.02,
            assumed_baseline: None,
        };
        let grown = |pose: &Rigid3| Rigid3::new(pose.rotation, pose.translation * scale);
        let before = factor.residual((&left, &right, &mount)).unwrap();
        let after = factor.residual((&grown(&left), &grown(&right), &grown(&mount))).unwrap();
        prop_assert!((before - after).norm() <= 1e-9 * (1.0 + before.norm()));
        let exact = mount * left;
        prop_assert!(factor.residual((&left, &exact, &mount)).unwrap().norm() < ZERO / 0.02);
    }
}

/// Two moments in five are wrong by metres and radians; the average still is where the others are.
#[test]
fn bad_moments_do_not_carry_the_average_off() {
    let truth = RelativePose {
        translation: Vector3::new(0.5, 0.02, -0.01),
        axis_angle: Vector3::new(0.01, 3.0, 0.1),
    };
    let mut rng = tiepoint_geometry::Rng::stream(3, &[]);
    let mut noise = |size: f64| Vector3::new(rng.normal(), rng.normal(), rng.normal()) * size;
    let poses: Vec<RelativePose> = (0..50)
        .map(|moment| {
            let (t, r) = if moment % 5 < 2 { (3.0, 1.0) } else { (0.002, 0.001) };
            let rotation = so3::exp(&noise(r)) * so3::exp(&truth.axis_angle);
            RelativePose {
                translation: truth.translation + noise(t),
                axis_angle: so3::log(&rotation),
            }
        })
        .collect();
    let found = robust_average(&poses).unwrap();
    // Two standard deviations of the good ones: bad ones pull in random directions.
    assert!((found.translation - truth.translation).norm() < 0.004, "{found:?}");
    assert!(
        so3::exp(&found.axis_angle).angle_to(&so3::exp(&truth.axis_angle)) < 0.002,
        "{found:?}"
    );
    assert_eq!(robust_average(&[]), None);
}
