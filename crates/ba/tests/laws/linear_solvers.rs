//! Every linear solver is compared with the QR factorisation of the whole Jacobian.

use crate::scene::{Intrinsics, NOISE_PX, Scene, solve, solve_as};
use rayon::ThreadPoolBuilder;
use tiepoint_ba::factors::{Between, Prior};
use tiepoint_ba::{LinearSolver, Loss, Options, Summary};

/// Rounding of normal equations with a condition number of about 1e8 in a solve of a few steps.
const SAME_COST: f64 = 1e-9;
/// Relative difference of intermediate costs: steps of eliminated variables are long, and single
/// precision has 6e-8.
const SAME_STEP: f64 = 1e-7;
const SAME_POSE: f64 = 1e-6;
/// Rounding of a centre 12 m from the origin, in a few steps.
const SAME_CENTRE: f64 = 1e-13;
const STEPS: usize = 6;
/// Relative difference of decreases, given the accuracy of iterative solutions.
const SIMILAR_STEP: f64 = 1e-4;

/// A scene with partly fixed variables, a fixed point, factors between kept variables, and robust
/// losses.
fn full_scene(intrinsics: Intrinsics) -> Scene {
    let mut scene = Scene::new(7, 60, 0.5, 5, intrinsics, NOISE_PX);
    let problem = &mut scene.problem;
    problem.fix(scene.poses[0]);
    // Its centre. A single coordinate of τ would be a direction that rotates with the camera
    // (CONVENTIONS.md).
    problem.fix_dofs(scene.poses[1], &[3, 4, 5]).unwrap();
    problem.fix_dofs(scene.intrinsics[0], &[1, 2]).unwrap();
    problem.fix(scene.points[3]);
    problem.fix_dofs(scene.points[4], &[1]).unwrap();
    for i in 1..scene.poses.len() {
        let b_from_a = scene.true_poses[i] * scene.true_poses[i - 1].inverse();
        let factor = Between::new(b_from_a, &[0.01; 6]).unwrap();
        problem.add((scene.poses[i - 1], scene.poses[i]), factor, Loss::Huber(1.0)).unwrap();
    }
    // A loop closure, and priors on a kept and on an eliminated variable.
    let b_from_a = scene.true_poses[6] * scene.true_poses[1].inverse();
    let closure = Between::new(b_from_a, &[0.02; 6]).unwrap();
    problem.add((scene.poses[6], scene.poses[1]), closure, Loss::Cauchy(1.0)).unwrap();
    problem
        .add(scene.poses[5], Prior::new(scene.true_poses[5], &[0.1; 6]).unwrap(), Loss::Trivial)
        .unwrap();
    problem
        .add(scene.points[9], Prior::new(scene.true_points[9], &[0.1; 3]).unwrap(), Loss::Trivial)
        .unwrap();
    scene
}

fn costs(summary: &Summary) -> Vec<f64> {
    summary.iterations.iter().map(|record| record.cost).collect()
}

#[test]
fn elimination_matches_qr() {
    for intrinsics in [Intrinsics::OneEach, Intrinsics::Shared] {
        let mut reference = full_scene(intrinsics);
        let expected = solve(&mut reference.problem, LinearSolver::Qr, STEPS);
        assert_eq!(expected.linear_solver, "dense QR");
        assert_eq!(expected.num_eliminated, 0);
        assert!(expected.final_cost < 0.1 * expected.initial_cost, "{expected}");
        for (solver, name) in
            [(LinearSolver::Dense, "dense Cholesky"), (LinearSolver::Sparse, "sparse Cholesky")]
        {
            let mut scene = full_scene(intrinsics);
            let found = solve(&mut scene.problem, solver, STEPS);
            assert_eq!(found.linear_solver, name);
            // All points but the fixed one. The partly fixed one keeps its width.
            assert_eq!(found.num_eliminated, 3 * 59);
            assert_eq!(found.iterations.len(), expected.iterations.len());
            for (a, b) in costs(&found).iter().zip(costs(&expected)) {
                assert!(
                    (a - b).abs() < SAME_STEP * b,
                    "{solver:?} {intrinsics:?}: {found}\n{expected}"
                );
            }
            assert!(
                (found.final_cost - expected.final_cost).abs() < SAME_COST * expected.final_cost
            );
            for (&a, &b) in scene.poses.iter().zip(&reference.poses) {
                let difference = scene.problem.get(a).inverse() * reference.problem.get(b);
                assert!(difference.translation.norm() + difference.rotation.angle() < SAME_POSE);
            }
        }
    }
}

#[test]
fn fixed_variables_do_not_move() {
    for solver in [LinearSolver::Qr, LinearSolver::Dense, LinearSolver::Sparse] {
        let before = full_scene(Intrinsics::OneEach);
        let mut after = full_scene(Intrinsics::OneEach);
        solve(&mut after.problem, solver, STEPS);
        let (old, new) = (&before.problem, &after.problem);
        assert_eq!(old.get(before.poses[0]), new.get(after.poses[0]));
        assert_ne!(old.get(before.poses[1]), new.get(after.poses[1]));
        let [was, is] =
            [old.get(before.poses[1]), new.get(after.poses[1])].map(|pose| pose.origin_in_a());
        assert!((was - is).norm() < SAME_CENTRE, "{was} {is}");
        assert_eq!(old.get(before.points[3]), new.get(after.points[3]));
        assert_eq!(old.get(before.points[4]).y, new.get(after.points[4]).y);
        assert_ne!(old.get(before.points[4]).x, new.get(after.points[4]).x);
        let [old, new] = [old.get(before.intrinsics[0]), new.get(after.intrinsics[0])];
        assert_eq!((old[1], old[2]), (new[1], new[2]));
        assert_ne!((old[0], old[3]), (new[0], new[3]));
    }
}

/// Enough factors for several tasks.
#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let run = |threads, solver| {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut scene = Scene::new(30, 2000, 0.8, 6, Intrinsics::Shared, NOISE_PX);
        scene.fix_gauge();
        let options = Options { linear_solver: solver, max_iterations: 4, ..Options::default() };
        let summary = pool.install(|| solve_as(&mut scene.problem, &options));
        let poses: Vec<_> = scene.poses.iter().map(|&pose| scene.problem.get(pose)).collect();
        let points: Vec<_> = scene.points.iter().map(|&point| scene.problem.get(point)).collect();
        (costs(&summary), poses, points)
    };
    for solver in
        [LinearSolver::Dense, LinearSolver::Sparse, LinearSolver::Iterative, LinearSolver::Implicit]
    {
        let one = run(1, solver);
        for threads in [2, 5] {
            assert_eq!(one, run(threads, solver));
        }
    }
}

/// Landmark refinement lowers the cost of every step, and leads to the same minimum.
#[test]
fn landmark_refinement_lowers_the_cost_and_keeps_the_minimum() {
    for intrinsics in [Intrinsics::OneEach, Intrinsics::Shared] {
        let run = |refinements, max_iterations| {
            let mut scene = full_scene(intrinsics);
            let options = Options {
                refinements,
                max_iterations,
                function_tolerance: 1e-12,
                ..Options::default()
            };
            let summary = solve_as(&mut scene.problem, &options);
            // Fixed variables do not move.
            let before = full_scene(intrinsics);
            assert_eq!(before.problem.get(before.points[3]), scene.problem.get(scene.points[3]));
            assert_eq!(
                before.problem.get(before.points[4]).y,
                scene.problem.get(scene.points[4]).y
            );
            assert!(
                (scene.problem.cost().total - summary.final_cost).abs()
                    < SAME_COST * summary.final_cost
            );
            summary
        };
        let (plain, refined) = (run(0, 1), run(2, 1));
        assert!(refined.final_cost < plain.final_cost, "{plain}\n{refined}");
        let (plain, refined) = (run(0, 100), run(2, 100));
        let difference = (plain.final_cost - refined.final_cost).abs();
        assert!(difference < SAME_COST * plain.final_cost, "{plain}\n{refined}");
    }
}

/// Iterative solutions are as good as direct ones and lead to the same minimum, whether the reduced
/// system is formed or not.
#[test]
fn conjugate_gradients_match_factorisation() {
    for intrinsics in [Intrinsics::OneEach, Intrinsics::Shared] {
        let run = |linear_solver| {
            let mut scene = full_scene(intrinsics);
            let options =
                Options { linear_solver, function_tolerance: 1e-12, ..Options::default() };
            solve_as(&mut scene.problem, &options)
        };
        let direct = run(LinearSolver::Dense);
        for (solver, name) in [
            (LinearSolver::Iterative, "conjugate gradients"),
            (LinearSolver::Implicit, "implicit conjugate gradients"),
        ] {
            let iterative = run(solver);
            assert_eq!(iterative.linear_solver, name);
            for (a, b) in costs(&iterative).iter().zip(costs(&direct)).take(STEPS) {
                assert!((a - b).abs() < SIMILAR_STEP * b, "{iterative}\n{direct}");
            }
            let difference = (iterative.final_cost - direct.final_cost).abs();
            assert!(difference < SAME_COST * direct.final_cost, "{iterative}\n{direct}");
        }
    }
}

/// A point that many cameras see fills the reduced system, which then has more elements than there
/// are observations.
#[test]
fn a_full_reduced_system_is_solved_implicitly() {
    let (few, many) = (
        Scene::new(7, 60, 0.5, 5, Intrinsics::OneEach, NOISE_PX),
        Scene::new(60, 30, 1.0, 60, Intrinsics::OneEach, NOISE_PX),
    );
    for (mut scene, name) in [(few, "conjugate gradients"), (many, "implicit conjugate gradients")]
    {
        scene.fix_gauge();
        assert_eq!(solve(&mut scene.problem, LinearSolver::Iterative, 1).linear_solver, name);
    }
}
