//! Every way to solve the linear system is checked against its slow twin, the QR factorisation of
//! the whole Jacobian.

use crate::scene::{Intrinsics, NOISE_PX, Scene, solve, solve_as};
use rayon::ThreadPoolBuilder;
use tiepoint_ba::factors::{Between, Prior};
use tiepoint_ba::{LinearSolver, Loss, Options, Summary};

/// Rounding of normal equations with a condition number of about 1e8 in a solve of a few steps.
const SAME_COST: f64 = 1e-9;
/// On the way there, where steps of eliminated variables are far, and right to the 6e-8 of single
/// precision.
const SAME_STEP: f64 = 1e-7;
const SAME_POSE: f64 = 1e-6;
/// Rounding of a centre 12 m from the origin, in a few steps.
const SAME_PLACE: f64 = 1e-13;
const STEPS: usize = 6;
/// What the accuracy to which a step is solved for leaves of the difference that it makes.
const SIMILAR_STEP: f64 = 1e-4;

/// A scene with everything in it: partly fixed variables, a fixed point, factors between kept
/// variables, robust losses.
fn everything(intrinsics: Intrinsics) -> Scene {
    let mut scene = Scene::new(7, 60, 0.5, 5, intrinsics, NOISE_PX);
    let problem = &mut scene.problem;
    problem.fix(scene.poses[0]);
    // Its centre: one coordinate of that would end elsewhere by another way (CONVENTIONS.md).
    problem.fix_dofs(scene.poses[1], &[3, 4, 5]).unwrap();
    problem.fix_dofs(scene.intrinsics[0], &[1, 2]).unwrap();
    problem.fix(scene.points[3]);
    problem.fix_dofs(scene.points[4], &[1]).unwrap();
    for i in 1..scene.poses.len() {
        let b_from_a = scene.true_poses[i] * scene.true_poses[i - 1].inverse();
        let factor = Between::new(b_from_a, &[0.01; 6]).unwrap();
        problem.add((scene.poses[i - 1], scene.poses[i]), factor, Loss::Huber(1.0)).unwrap();
    }
    // A loop closure, and a prior on one kept and on one eliminated variable.
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
fn eliminating_is_the_same_as_not_eliminating() {
    for intrinsics in [Intrinsics::OneEach, Intrinsics::Shared] {
        let mut twin = everything(intrinsics);
        let expected = solve(&mut twin.problem, LinearSolver::Qr, STEPS);
        assert_eq!(expected.linear_solver, "dense QR");
        assert_eq!(expected.num_eliminated, 0);
        assert!(expected.final_cost < 0.1 * expected.initial_cost, "{expected}");
        for (solver, name) in
            [(LinearSolver::Dense, "dense Cholesky"), (LinearSolver::Sparse, "sparse Cholesky")]
        {
            let mut scene = everything(intrinsics);
            let found = solve(&mut scene.problem, solver, STEPS);
            assert_eq!(found.linear_solver, name);
            // All points but the fixed one; the partly fixed one keeps its width.
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
            for (&a, &b) in scene.poses.iter().zip(&twin.poses) {
                let difference = scene.problem.get(a).inverse() * twin.problem.get(b);
                assert!(difference.translation.norm() + difference.rotation.angle() < SAME_POSE);
            }
        }
    }
}

#[test]
fn what_is_fixed_does_not_move() {
    for solver in [LinearSolver::Qr, LinearSolver::Dense, LinearSolver::Sparse] {
        let before = everything(Intrinsics::OneEach);
        let mut after = everything(Intrinsics::OneEach);
        solve(&mut after.problem, solver, STEPS);
        let (old, new) = (&before.problem, &after.problem);
        assert_eq!(old.get(before.poses[0]), new.get(after.poses[0]));
        assert_ne!(old.get(before.poses[1]), new.get(after.poses[1]));
        let [was, is] =
            [old.get(before.poses[1]), new.get(after.poses[1])].map(|pose| pose.origin_in_a());
        assert!((was - is).norm() < SAME_PLACE, "{was} {is}");
        assert_eq!(old.get(before.points[3]), new.get(after.points[3]));
        assert_eq!(old.get(before.points[4]).y, new.get(after.points[4]).y);
        assert_ne!(old.get(before.points[4]).x, new.get(after.points[4]).x);
        let [old, new] = [old.get(before.intrinsics[0]), new.get(after.intrinsics[0])];
        assert_eq!((old[1], old[2]), (new[1], new[2]));
        assert_ne!((old[0], old[3]), (new[0], new[3]));
    }
}

/// Enough factors for several chunks of work, so that there is something to share out.
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

/// Points improved on their own lower the cost of every step, and lead to the same end.
#[test]
fn refinement_lowers_the_cost_and_ends_the_same() {
    for intrinsics in [Intrinsics::OneEach, Intrinsics::Shared] {
        let run = |refinements, max_iterations| {
            let mut scene = everything(intrinsics);
            let options = Options {
                refinements,
                max_iterations,
                function_tolerance: 1e-12,
                ..Options::default()
            };
            let summary = solve_as(&mut scene.problem, &options);
            // What is held stays where it is.
            let before = everything(intrinsics);
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

/// Steps solved for iteratively are as good as those solved for directly, and lead to the same end,
/// whether the reduced system is put together or not.
#[test]
fn conjugate_gradients_end_where_factorisation_does() {
    for intrinsics in [Intrinsics::OneEach, Intrinsics::Shared] {
        let run = |linear_solver| {
            let mut scene = everything(intrinsics);
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

/// A point that all of many cameras see fills the reduced system, which then has more numbers than
/// there are observations.
#[test]
fn what_would_have_more_numbers_than_observations_is_not_put_together() {
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
