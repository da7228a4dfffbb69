//! Degenerate and invalid problems: either an error with the numbers, or a termination in the
//! summary. No panic and no silent NaN.

use std::ops::ControlFlow;

use tiepoint_ba::factor::{Linear, Refs};
use tiepoint_ba::factors::{Between, Prior, Reprojection};
use tiepoint_ba::nalgebra::{SMatrix, SVector, Vector2, Vector3, Vector4};
use tiepoint_ba::{
    EliminationOrder, Error, Factor, LinearSolver, Loss, Options, Problem, Solver, Summary,
    Termination,
};
use tiepoint_geometry::Rigid3;
use tiepoint_geometry::cameras::SimpleRadial;

use crate::scene::{Intrinsics, NOISE_PX, PARAMS, Scene, solve};

const SOLVERS: [LinearSolver; 6] = [
    LinearSolver::Auto,
    LinearSolver::Qr,
    LinearSolver::Dense,
    LinearSolver::Sparse,
    LinearSolver::Iterative,
    LinearSolver::Implicit,
];

/// About a hundred operations in double precision.
const ROUNDING: f64 = 1e-12;

fn try_solve(problem: &mut Problem, options: &Options) -> Result<Summary, Error> {
    Solver::new(problem, options)?.solve(problem)
}

fn options_with(linear_solver: LinearSolver) -> Options {
    Options { linear_solver, ..Options::default() }
}

/// x − target, times `residual`, with the derivative `slope`.
#[derive(Clone, Copy)]
struct Corrupted {
    target: f64,
    residual: f64,
    slope: f64,
}

impl Factor<1> for Corrupted {
    type Vars = (f64,);
    fn linearize(&self, (x,): Refs<'_, Self::Vars>) -> Option<Linear<Self::Vars, 1>> {
        let residual = SVector::<f64, 1>::new((x - self.target) * self.residual);
        Some((residual, (SMatrix::<f64, 1, 1>::new(self.slope),)))
    }
}

#[test]
fn problems_without_unknowns_end_at_once() {
    for solver in SOLVERS {
        let mut empty = Problem::new();
        let summary = solve(&mut empty, solver, 10);
        assert_eq!((summary.termination, summary.final_cost), (Termination::Nothing, 0.0));

        let mut no_factors = Problem::new();
        let x = no_factors.add_parameter(1.5, EliminationOrder::Last);
        assert_eq!(solve(&mut no_factors, solver, 10).termination, Termination::Nothing);
        assert_eq!(no_factors.get(x), 1.5);

        let mut all_fixed = Problem::new();
        let x = all_fixed.add_parameter(1.5, EliminationOrder::Last);
        all_fixed.fix(x);
        all_fixed.add(x, Prior::new(1.0, &[1.0]).unwrap(), Loss::Trivial).unwrap();
        let summary = solve(&mut all_fixed, solver, 10);
        assert_eq!((summary.termination, summary.final_cost), (Termination::Nothing, 0.125));
    }
}

#[test]
fn non_finite_initial_values_are_reported() {
    for solver in SOLVERS {
        for (corrupted, what) in [
            (Corrupted { target: 0.0, residual: f64::NAN, slope: 1.0 }, "residual"),
            (Corrupted { target: 0.0, residual: f64::INFINITY, slope: 1.0 }, "residual"),
            (Corrupted { target: 0.0, residual: 1e200, slope: 1.0 }, "squared residual"),
            (Corrupted { target: 0.0, residual: 1.0, slope: f64::NAN }, "Jacobian"),
            (Corrupted { target: 0.0, residual: 1.0, slope: f64::INFINITY }, "Jacobian"),
        ] {
            let mut problem = Problem::new();
            let x = problem.add_parameter(1.0, EliminationOrder::Last);
            problem
                .add(x, Corrupted { target: 0.0, residual: 1.0, slope: 1.0 }, Loss::Trivial)
                .unwrap();
            problem.add(x, corrupted, Loss::Trivial).unwrap();
            match try_solve(&mut problem, &options_with(solver)) {
                Err(Error::NotFinite { index: 1, what: found, .. }) => assert_eq!(found, what),
                other => panic!("{solver:?} {what}: {other:?}"),
            }
            assert_eq!(problem.get(x), 1.0);
        }
    }
}

/// √x is not finite for negative x, and its derivative is not at zero. A full step from 4 leads to
/// −4.
struct Root;
impl Factor<1> for Root {
    type Vars = (f64,);
    fn linearize(&self, (x,): Refs<'_, Self::Vars>) -> Option<Linear<Self::Vars, 1>> {
        let root = x.sqrt(); // NaN for negative numbers
        Some((SVector::<f64, 1>::new(root), (SMatrix::<f64, 1, 1>::new(0.5 / root),)))
    }
}

#[test]
fn a_step_to_non_finite_values_is_rejected() {
    for solver in SOLVERS {
        let mut problem = Problem::new();
        let x = problem.add_parameter(4.0, EliminationOrder::Last);
        problem.add(x, Root, Loss::Trivial).unwrap();
        let summary = solve(&mut problem, solver, 100);
        assert!(summary.iterations.iter().any(|record| !record.accepted), "{summary}");
        assert!(summary.final_cost.is_finite() && summary.final_cost <= summary.initial_cost);
        assert!(problem.get(x) >= 0.0 && problem.get(x) < 4.0);
    }
}

#[test]
fn undetermined_directions_do_not_move() {
    // No gauge is fixed, so seven directions of the scene are free. One camera has no observations.
    for solver in SOLVERS {
        let mut scene = Scene::new(5, 40, 0.6, 5, Intrinsics::Shared, NOISE_PX);
        let alone =
            Rigid3::from_axis_angle(Vector3::new(0.1, 0.2, 0.3), Vector3::new(1.0, 2.0, 3.0));
        let key = scene.problem.add_parameter(alone, EliminationOrder::At(3));
        let summary = solve(&mut scene.problem, solver, 30);
        assert!(summary.final_cost < 0.1 * summary.initial_cost, "{solver:?}: {summary}");
        let moved = scene.problem.get(key) * alone.inverse();
        assert!(moved.translation.norm() + moved.rotation.angle() < ROUNDING);
        assert!(scene.poses.iter().all(|&pose| scene.problem.get(pose).translation.norm() < 100.0));
    }
}

#[test]
fn independent_subproblems_are_solved() {
    for solver in SOLVERS {
        let mut problem = Problem::new();
        let (a, b) = (
            problem.add_parameter(0.0, EliminationOrder::At(0)),
            problem.add_parameter(Vector2::new(5.0, 5.0), EliminationOrder::At(9)),
        );
        problem.add(a, Prior::new(3.0, &[0.5]).unwrap(), Loss::Trivial).unwrap();
        problem
            .add(b, Prior::new(Vector2::new(1.0, -1.0), &[1.0, 2.0]).unwrap(), Loss::Trivial)
            .unwrap();
        let summary = solve(&mut problem, solver, 50);
        assert!(summary.termination.converged(), "{summary}");
        assert!((problem.get(a) - 3.0).abs() < 1e-6);
        assert!((problem.get(b) - Vector2::new(1.0, -1.0)).norm() < 1e-6);
    }
}

/// Cameras at the origin and beside it, which look along z at a point.
fn two_cameras(
    point: Vector3<f64>,
    pixel: Vector2<f64>,
) -> (Problem, tiepoint_ba::Key<Vector3<f64>>) {
    let mut problem = Problem::new();
    let params = problem.add_parameter(Vector4::from(PARAMS), EliminationOrder::Last);
    problem.fix(params);
    let key = problem.add_landmark(point);
    for x in [0.0, -1.0] {
        let pose = problem.add_parameter(
            Rigid3::from_axis_angle(Vector3::zeros(), Vector3::new(x, 0.0, 0.0)),
            EliminationOrder::Last,
        );
        problem.fix(pose);
        let factor = Reprojection::<SimpleRadial>::new(pixel + Vector2::new(100.0 * x, 0.0), 1.0);
        problem.add((params, pose, key), factor, Loss::Trivial).unwrap();
    }
    (problem, key)
}

#[test]
fn points_behind_cameras_do_not_count_and_others_stay_in_front() {
    let (mut behind, key) = two_cameras(Vector3::new(0.1, 0.1, -5.0), Vector2::new(330.0, 250.0));
    let cost = behind.cost();
    assert_eq!((cost.total, cost.missing), (0.0, 2));
    let summary = solve(&mut behind, LinearSolver::Dense, 10);
    assert_eq!((summary.final_cost, summary.missing_factors), (0.0, 2));
    assert_eq!(behind.get(key), Vector3::new(0.1, 0.1, -5.0));

    // The true depth is 6. The disparity is proportional to 1/z, so a full step leads from z to 2z
    // − z²/6: behind the camera if z is above 12.
    let (mut far, key) = two_cameras(Vector3::new(0.0, 0.0, 20.0), Vector2::new(330.0, 250.0));
    let summary = solve(&mut far, LinearSolver::Dense, 100);
    assert_eq!(summary.missing_factors, 0);
    assert!((far.get(key).z - 6.0).abs() < 0.1, "{} {summary}", far.get(key));
}

#[test]
fn a_camera_may_move_past_a_mismatched_point() {
    // Nine exact points, seen from the origin and from a metre behind it, determine a camera that
    // starts a metre behind its true position. A mismatch puts a tenth point between the two, at
    // the image centre, where its projection is independent of the camera's position.
    const NEAR: f64 = 0.1;
    let [fx, cx, cy, _] = PARAMS;
    for solver in
        [LinearSolver::Dense, LinearSolver::Sparse, LinearSolver::Iterative, LinearSolver::Implicit]
    {
        let mut problem = Problem::new();
        let params = problem.add_parameter(Vector4::new(fx, cx, cy, 0.0), EliminationOrder::Last);
        problem.fix(params);
        let poses = [0.0, 1.0, 0.0].map(|back| {
            problem.add_parameter(
                Rigid3::from_axis_angle(Vector3::zeros(), Vector3::new(0.0, 0.0, back)),
                EliminationOrder::Last,
            )
        });
        problem.fix(poses[0]);
        problem.fix(poses[1]);
        let camera = poses[2];
        let (seen_from, truth) = ([0.0, 1.0, -1.0], Vector3::new(0.0, 0.0, -1.0));
        for i in 0..9 {
            let at = Vector3::new(
                f64::from(i % 3) - 1.0,
                f64::from(i / 3) - 1.0,
                6.0 + 0.3 * f64::from(i),
            );
            let point = problem.add_landmark(at);
            for (pose, shift) in poses.into_iter().zip(seen_from) {
                let depth = at.z + shift;
                let pixel = Vector2::new(fx * at.x / depth + cx, fx * at.y / depth + cy);
                let factor = Reprojection::<SimpleRadial>::new(pixel, 1.0);
                problem.add((params, pose, point), factor, Loss::Trivial).unwrap();
            }
        }
        let near = problem.add_landmark(Vector3::new(0.0, 0.0, NEAR));
        for pose in [poses[1], camera] {
            let factor = Reprojection::<SimpleRadial>::new(Vector2::new(cx, cy), 1.0);
            problem.add((params, pose, near), factor, Loss::Trivial).unwrap();
        }
        assert_eq!(problem.cost().missing, 0);
        let summary = solve(&mut problem, solver, 50);
        assert_eq!(summary.missing_factors, 1, "{solver:?}: {summary}");
        assert!((problem.get(camera).translation - truth).norm() < 1e-6, "{solver:?}: {summary}");
        assert!((summary.final_cost - problem.cost().total).abs() < 1e-9, "{solver:?}: {summary}");
        assert_eq!(problem.get(near).z, NEAR, "its variable stands still");
    }
}

#[test]
fn invalid_input_is_reported() {
    let mut problem = Problem::new();
    let pose = problem.add_parameter(Rigid3::identity(), EliminationOrder::At(0));
    let between = Between::new(Rigid3::identity(), &[1.0; 6]).unwrap();
    assert!(matches!(
        problem.add((pose, pose), between, Loss::Trivial),
        Err(Error::RepeatedVariable { first: 0, second: 1, .. })
    ));
    let mut other = Problem::new();
    other.add_parameter(Rigid3::identity(), EliminationOrder::At(0));
    let foreign = other.add_parameter(Rigid3::identity(), EliminationOrder::At(0));
    assert!(matches!(
        problem.add((pose, foreign), between, Loss::Trivial),
        Err(Error::UnknownKey { position: 1, slot: 1, len: 1, .. })
    ));
    assert!(matches!(
        problem.fix_dofs(pose, &[2, 6]),
        Err(Error::TangentIndex { index: 6, dof: 6, .. })
    ));
    assert!(matches!(
        problem.add(pose, Prior::new(Rigid3::identity(), &[1.0; 6]).unwrap(), Loss::Huber(-1.0)),
        Err(Error::LossScale { .. })
    ));
    assert!(matches!(Prior::new(1.0, &[0.0]), Err(Error::Sigma { index: 0, value: 0.0 })));
    assert!(matches!(
        Between::new(Rigid3::identity(), &[1.0, 1.0, f64::NAN, 1.0, 1.0, 1.0]),
        Err(Error::Sigma { index: 2, .. })
    ));
    let (a, b) = (problem.add_landmark(Vector3::zeros()), problem.add_landmark(Vector3::zeros()));
    let _ = (a, b);
    let [a, b] = [0.0, 1.0].map(|x| {
        problem.add_landmark(Rigid3::from_axis_angle(Vector3::zeros(), Vector3::new(x, 0.0, 0.0)))
    });
    problem.add((a, b), between, Loss::Trivial).unwrap();
    let options = Options::default();
    assert!(matches!(
        Solver::new(&problem, &options),
        Err(Error::TwoEliminated { first: 0, second: 1, .. })
    ));
    problem.fix(b);
    let mut solver = Solver::new(&problem, &options).unwrap();
    problem.free(b);
    assert_eq!(solver.solve(&mut problem), Err(Error::StructureChanged));
    let options = Options { function_tolerance: f64::NAN, ..Options::default() };
    assert!(matches!(
        Solver::new(&problem, &options),
        Err(Error::Option { name: "function_tolerance", .. })
    ));
    let options = Options { initial_damping: 0.0, ..Options::default() };
    assert!(matches!(
        Solver::new(&problem, &options),
        Err(Error::Option { name: "initial_damping", .. })
    ));
}

#[test]
fn a_cancelled_solve_can_be_resumed() {
    let mut scene = Scene::new(6, 60, 0.6, 5, Intrinsics::Shared, NOISE_PX);
    scene.fix_gauge();
    let mut solver = Solver::new(&scene.problem, &Options::default()).unwrap();
    let first = solver
        .solve_with(&mut scene.problem, &mut |record| {
            if record.number == 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })
        .unwrap();
    assert_eq!((first.termination, first.iterations.len()), (Termination::Cancelled, 2));
    let second = solver.solve(&mut scene.problem).unwrap();
    assert!((second.initial_cost - first.final_cost).abs() < ROUNDING * first.final_cost);
    assert_eq!(first.final_cost, first.iterations[1].cost);
    assert!(second.termination.converged() && second.final_cost < first.final_cost);
}

/// One in eight observations is off by 50 units. Robust losses suppress them, least squares does
/// not.
#[test]
fn robust_losses_withstand_gross_errors() {
    let estimate_error = |loss: Loss| {
        let mut problem = Problem::new();
        let x = problem.add_parameter(Vector2::new(0.3, -0.2), EliminationOrder::Last);
        for i in 0..40 {
            let wave = 0.1 * f64::from(i).sin();
            let gross = if i % 8 == 0 { 50.0 } else { 0.0 };
            let prior = Prior::new(Vector2::new(wave + gross, wave), &[1.0, 1.0]).unwrap();
            problem.add(x, prior, loss).unwrap();
        }
        let summary = solve(&mut problem, LinearSolver::Auto, 100);
        assert!(summary.termination.converged(), "{loss:?} {summary}");
        problem.get(x).norm()
    };
    assert!(estimate_error(Loss::Trivial) > 6.0);
    for loss in [Loss::Huber(1.0), Loss::SoftL1(1.0), Loss::Cauchy(1.0)] {
        assert!(estimate_error(loss) < 0.3, "{loss:?} {}", estimate_error(loss));
    }
    // Redescending losses.
    for loss in [Loss::GemanMcClure(1.0), Loss::Tukey(2.0), Loss::Truncated(2.0)] {
        assert!(estimate_error(loss) < 0.05, "{loss:?} {}", estimate_error(loss));
    }
}
