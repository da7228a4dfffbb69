//! Numerical tests of the baseline factor and the rig extrinsics: Jacobians, zeros, the branch near
//! π, and the weights of Eq. (2) and (4).

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

/// Camera poses at two frames, with a small change of the relative pose between them.
fn two_frames(
    axis_angle: impl Strategy<Value = Vector3<f64>>,
) -> impl Strategy<Value = [Rigid3; 4]> {
    (pose(), pose(), axis_angle, vector(1.0), vector(0.05), vector(0.05)).prop_map(
        |(left, next_left, w, t, dw, dt)| {
            let cam_from_rig = Rigid3::from_axis_angle(w, t);
            let next_cam_from_rig = Rigid3::new(so3::exp(&dw) * cam_from_rig.rotation, t + dt);
            [left, cam_from_rig * left, next_left, next_cam_from_rig * next_left]
        },
    )
}

fn near_pi() -> impl Strategy<Value = Vector3<f64>> {
    (vector(1.0), -0.02..0.02).prop_filter_map("an axis", |(axis, error)| {
        let axis = axis.try_normalize(0.1)?;
        Some(axis * (std::f64::consts::PI + error))
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
    fn baseline_jacobian(m in two_frames(vector(1.5))) {
        check(m);
    }

    #[test]
    fn baseline_jacobian_for_opposite_directions(m in two_frames(near_pi())) {
        check(m);
    }

    #[test]
    fn baseline_jacobian_for_equal_directions(m in two_frames(vector(1e-9))) {
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
    fn cam_from_rig_inverts_between(left in pose(), w in vector(1.5), t in vector(1.0)) {
        let rig = Rigid3::from_axis_angle(w, t);
        let inverted = RelativePose::between(&left, &(rig * left)).cam_from_rig();
        prop_assert!((inverted.translation - rig.translation).norm() < 1e-9);
        prop_assert!(inverted.rotation.angle_to(&rig.rotation) < 1e-7);
    }
}

fn p(t: f64, a: f64) -> RelativePose {
    RelativePose {
        translation: Vector3::new(t, 0.01, 0.02),
        axis_angle: Vector3::new(0.01, a, 0.01),
    }
}

#[test]
fn the_weight_grows_with_the_fraction_of_pairs() {
    assert_eq!(paper::growing_weight(3, 6), 250.0);
    assert_eq!(paper::growing_weight(6, 6), 500.0);
}

#[test]
fn links_of_a_pair_with_one_bad_element_have_the_larger_weight() {
    let mut poses = vec![p(0.5, 0.1); 20];
    poses[7] = p(0.5, -0.8);
    let weights = paper::final_link_weights(&poses);
    let expected: Vec<f64> =
        (0..19).map(|i| if i == 6 || i == 7 { 500.0 } else { 250.0 }).collect();
    assert_eq!(weights, expected);
}

#[test]
fn statistics_of_a_drifting_baseline() {
    let poses: Vec<RelativePose> = (0..10).map(|i| p(if i < 5 { 0.5 } else { 0.4 }, 0.1)).collect();
    let statistics = relative_pose_statistics(&poses).unwrap();
    assert!((statistics.second_over_first_half - 0.8).abs() < 0.01);
    assert!(statistics.rms_rotation_rad < 1e-9);
    assert!((statistics.rms_translation - 0.05).abs() < 1e-12);
}

/// Camera poses at one frame, and extrinsics that differ slightly from them.
fn perturbed_rig(
    axis_angle: impl Strategy<Value = Vector3<f64>>,
) -> impl Strategy<Value = [Rigid3; 3]> {
    (pose(), axis_angle, vector(1.0), vector(0.2), vector(0.2)).prop_filter_map(
        "a baseline",
        |(left, w, t, dw, dt)| {
            let extrinsics = Rigid3::from_axis_angle(w, t);
            let cam_from_rig = Rigid3::new(so3::exp(&dw) * extrinsics.rotation, t + dt);
            (t.norm() > 0.2).then_some([left, cam_from_rig * left, extrinsics])
        },
    )
}

fn check_extrinsics([left, right, extrinsics]: [Rigid3; 3]) {
    for assumed_baseline in [None, Some(0.7)] {
        let factor = SynchronousExtrinsics {
            sigma_translation: 0.05,
            sigma_rotation_rad: 0.02,
            assumed_baseline,
        };
        if let Err(difference) =
            check_jacobians(&factor, (left, right, extrinsics), JACOBIAN_TOLERANCE)
        {
            panic!("{assumed_baseline:?}: {difference}");
        }
    }
}

/// Rounding of numbers of about 10, times the weights.
const ZERO: f64 = 1e-10;

proptest! {
    #[test]
    fn extrinsics_jacobian_for_any(m in perturbed_rig(vector(1.5))) {
        check_extrinsics(m);
    }

    #[test]
    fn extrinsics_jacobian_for_opposite_directions(m in perturbed_rig(near_pi())) {
        check_extrinsics(m);
    }

    #[test]
    fn extrinsics_jacobian_for_equal_directions(m in perturbed_rig(vector(1e-9))) {
        check_extrinsics(m);
    }

    /// Scaling the model together with its extrinsics does not change the residual.
    #[test]
    fn extrinsics_residual_is_independent_of_scale(
        [left, right, extrinsics] in perturbed_rig(vector(1.0)),
        scale in 0.01..100.0,
    ) {
        use tiepoint_rig::ba::Factor;
        let factor = SynchronousExtrinsics {
            sigma_translation: 0.05,
            sigma_rotation_rad: 0.02,
            assumed_baseline: None,
        };
        let scaled = |pose: &Rigid3| Rigid3::new(pose.rotation, pose.translation * scale);
        let before = factor.residual((&left, &right, &extrinsics)).unwrap();
        let scaled = [left, right, extrinsics].map(|pose| scaled(&pose));
        let after =
            factor.residual((&scaled[0], &scaled[1], &scaled[2])).unwrap();
        prop_assert!((before - after).norm() <= 1e-9 * (1.0 + before.norm()));
        let exact = extrinsics * left;
        prop_assert!(factor.residual((&left, &exact, &extrinsics)).unwrap().norm() < ZERO / 0.02);
    }
}

/// Two frames in five are wrong by metres and radians; the average stays near the others.
#[test]
fn outliers_do_not_bias_the_robust_average() {
    let truth = RelativePose {
        translation: Vector3::new(0.5, 0.02, -0.01),
        axis_angle: Vector3::new(0.01, 3.0, 0.1),
    };
    let mut rng = tiepoint_geometry::Rng::stream(3, &[]);
    let mut noise = |size: f64| Vector3::new(rng.normal(), rng.normal(), rng.normal()) * size;
    let poses: Vec<RelativePose> = (0..50)
        .map(|frame| {
            let (t, r) = if frame % 5 < 2 { (3.0, 1.0) } else { (0.002, 0.001) };
            let rotation = so3::exp(&noise(r)) * so3::exp(&truth.axis_angle);
            RelativePose {
                translation: truth.translation + noise(t),
                axis_angle: so3::log(&rotation),
            }
        })
        .collect();
    let found = robust_average(&poses).unwrap();
    // Two standard deviations of the inliers. The outliers have random directions.
    assert!((found.translation - truth.translation).norm() < 0.004, "{found:?}");
    assert!(
        so3::exp(&found.axis_angle).angle_to(&so3::exp(&truth.axis_angle)) < 0.002,
        "{found:?}"
    );
    assert_eq!(robust_average(&[]), None);
}
