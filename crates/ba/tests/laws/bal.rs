//! Problems of "Bundle adjustment in the large" reach the final cost of Ceres.

use proptest::prelude::*;
use tiepoint_ba::autodiff::AutoDiff;
use tiepoint_ba::nalgebra::{Vector2, Vector3};
use tiepoint_ba::testing::check_jacobians;
use tiepoint_ba::{Factor, LinearSolver, Options};
use tiepoint_geometry::{Rigid3, so3};

use crate::file::{Bal, Derivatives};
use crate::scene::{solve, solve_as};
use crate::skipped;
use crate::snavely::{Snavely, SnavelyResidual};

/// Initial and final cost of Ceres, 50 iterations, dense Schur. Two independent programs gave the
/// same initial cost.
const LADYBUG_49: (&str, f64, f64) = ("bal/problem-49-7776-pre.txt", 8.50912e5, 1.334430e4);
const TRAFALGAR_21: (&str, f64, f64) = ("bal/problem-21-11315-pre.txt", 4.41324e6, 3.037864e4);
/// Initial costs are given to six digits. Final costs may differ by a tenth of a percent.
const START_TOLERANCE: f64 = 2e-6;
const END_TOLERANCE: f64 = 1e-3;
/// Derivatives by hand and by dual numbers differ in the order of operations, which four steps
/// amplify.
const SAME_COST: f64 = 1e-8;

fn read(file: &str) -> Option<Bal> {
    let text = std::fs::read_to_string(skipped::data()?.join(file)).unwrap();
    Some(Bal::parse(&text).unwrap())
}

#[test]
fn ladybug_49_reaches_the_cost_of_ceres() {
    for (file, start, end) in [LADYBUG_49, TRAFALGAR_21] {
        let Some(mut bal) = read(file) else { return };
        let (mut problem, keys) = bal.problem(Derivatives::ByHand).unwrap();
        let summary = solve_as(&mut problem, &Options { max_iterations: 50, ..Options::default() });
        assert!(
            (summary.initial_cost - start).abs() < START_TOLERANCE * start,
            "{file}: {summary}"
        );
        assert!(summary.final_cost < end * (1.0 + END_TOLERANCE), "{file}: {summary}");
        assert_eq!(summary.final_cost, summary.iterations.last().unwrap().cost);
        bal.update(&problem, &keys);
        let (adjusted, _) = bal.problem(Derivatives::ByDualNumbers).unwrap();
        assert!((adjusted.cost().total - summary.final_cost).abs() < 1e-9 * end);
    }
}

#[test]
fn dual_numbers_take_the_same_steps() {
    let Some(bal) = read(TRAFALGAR_21.0) else { return };
    let [by_hand, by_dual] = [Derivatives::ByHand, Derivatives::ByDualNumbers].map(|derivatives| {
        let (mut problem, _) = bal.problem(derivatives).unwrap();
        solve(&mut problem, LinearSolver::Auto, 4)
    });
    for (a, b) in by_hand.iterations.iter().zip(&by_dual.iterations) {
        assert!((a.cost - b.cost).abs() < SAME_COST * b.cost, "{by_hand}\n{by_dual}");
    }
}

proptest! {
    #[test]
    fn snavely(
        turn in prop::array::uniform3(-2.0..2.0),
        shift in prop::array::uniform3(-2.0..2.0),
        f in 300.0..900.0,
        k1 in -0.1..0.1,
        k2 in -0.01..0.01,
        x in -1.0..1.0,
        y in -1.0..1.0,
        z in -20.0..-2.0,
    ) {
        let pose = Rigid3::from_axis_angle(Vector3::from(turn), Vector3::from(shift));
        let point = pose.inverse() * Vector3::new(x * z, y * z, z);
        let factor = Snavely { pixel: Vector2::new(20.0, -40.0) };
        let intrinsics = Vector3::new(f, k1, k2);
        let law = check_jacobians(&factor, (pose, intrinsics, point), 1e-7);
        prop_assert_eq!(law, Ok(()));
        let (residual, by_hand) = factor.linearize((&pose, &intrinsics, &point)).unwrap();
        let (twin_residual, by_dual) =
            AutoDiff(SnavelyResidual(factor)).linearize((&pose, &intrinsics, &point)).unwrap();
        prop_assert!((residual - twin_residual).norm() < 1e-9);
        prop_assert!((by_hand.0 - by_dual.0).norm() < 1e-9 * by_hand.0.norm());
        prop_assert!((by_hand.1 - by_dual.1).norm() < 1e-9 * by_hand.1.norm());
        prop_assert!((by_hand.2 - by_dual.2).norm() < 1e-9 * by_hand.2.norm());
    }
}

#[test]
fn a_file_can_be_read_back() {
    let pose = Rigid3 {
        rotation: so3::exp(&Vector3::new(0.1, -0.2, 0.3)),
        translation: Vector3::new(1.0, 2.0, 3.0),
    };
    let bal = Bal {
        observations: vec![crate::file::Observation {
            camera: 0,
            point: 1,
            pixel: Vector2::new(-3.5, 4.25),
        }],
        poses: vec![pose],
        intrinsics: vec![Vector3::new(500.0, -1e-7, 1e-13)],
        points: vec![Vector3::zeros(), Vector3::new(1.0, 0.1, -3e10)],
    };
    let again = Bal::parse(&bal.to_text()).unwrap();
    assert_eq!(
        (&again.observations, &again.intrinsics, &again.points),
        (&bal.observations, &bal.intrinsics, &bal.points)
    );
    assert!((again.poses[0].rotation.angle_to(&pose.rotation)) < 1e-15);
    for (text, problem) in [
        ("1 1", "the file ends where the number of observations should be"),
        ("1 1 1 0 1 0 0", "camera 0 of 1 sees point 1 of 1"),
        ("0 1 0 1 2 3 4", "'4' follows the last of 1 points"),
        ("1 1 1 0 x 0 0", "a point: 'x' is not a number"),
    ] {
        assert_eq!(Bal::parse(text), Err(problem.to_owned()));
    }
}
