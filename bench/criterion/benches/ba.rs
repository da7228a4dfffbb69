//! Time of the parts of a solve: analysis, one step, the cost alone, and covariances. The problem
//! is a short drive of two cameras with fixed intrinsics.

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use tiepoint_ba::factors::Reprojection;
use tiepoint_ba::nalgebra::{Vector2, Vector3, Vector4};
use tiepoint_ba::{EliminationOrder, Key, LinearSolver, Loss, Options, Problem, Solver};
use tiepoint_geometry::cameras::Pinhole;
use tiepoint_geometry::{CameraModel, Rigid3, Rng};

const FRAMES: usize = 40;
const POINTS_PER_FRAME: usize = 100;
/// Number of frames that see a point.
const TRACK_LENGTH: usize = 5;

fn drive() -> (Problem, Vec<Key<Rigid3>>) {
    let (mut problem, mut rng) = (Problem::new(), Rng::stream(1, &[]));
    let intrinsics = Vector4::new(900.0, 900.0, 960.0, 540.0);
    let intrinsics_key = problem.add_parameter(intrinsics, EliminationOrder::Last);
    problem.fix(intrinsics_key);
    let at = |i: usize, side: usize| {
        Rigid3::from_axis_angle(
            Vector3::zeros(),
            Vector3::new(-(i as f64) - 0.8 * side as f64, 0.0, 0.0),
        )
    };
    let poses: Vec<_> = (0..FRAMES)
        .flat_map(|i| [0, 1].map(|side| (i, side)))
        .map(|(i, side)| problem.add_parameter(at(i, side), EliminationOrder::At(i as u32)))
        .collect();
    problem.fix(poses[0]);
    problem.fix(poses[1]);
    for i in 0..FRAMES {
        for _ in 0..POINTS_PER_FRAME {
            let point = Vector3::new(
                i as f64 + 4.0 * rng.uniform() - 2.0,
                6.0 * rng.uniform() - 3.0,
                6.0 + 6.0 * rng.uniform(),
            );
            let perturbation = Vector3::new(rng.normal(), rng.normal(), rng.normal()) * 0.05;
            let key = problem.add_landmark(point + perturbation);
            for j in i..(i + TRACK_LENGTH).min(FRAMES) {
                for side in 0..2 {
                    let Some(pixel) = Pinhole::project(&intrinsics, &(at(j, side) * point)) else {
                        continue;
                    };
                    let factor = Reprojection::<Pinhole>::new(
                        pixel + Vector2::new(rng.normal(), rng.normal()),
                        1.0,
                    );
                    let added = problem.add(
                        (intrinsics_key, poses[2 * j + side], key),
                        factor,
                        Loss::Huber(2.0),
                    );
                    assert!(added.is_ok());
                }
            }
        }
    }
    (problem, poses)
}

fn paths(criterion: &mut Criterion) {
    let (problem, poses) = drive();
    criterion.bench_function("analysis", |b| {
        b.iter(|| Solver::new(&problem, &Options::default()).is_ok())
    });
    criterion.bench_function("cost", |b| b.iter(|| problem.cost()));
    let keys = [poses[10].into(), poses[70].into()];
    criterion.bench_function("covariance", |b| b.iter(|| problem.covariance(&keys).is_ok()));
    for (name, linear_solver, refinements) in [
        ("step, dense", LinearSolver::Dense, 0),
        ("step, sparse", LinearSolver::Sparse, 0),
        ("step, iterative", LinearSolver::Iterative, 0),
        ("step, dense, refined", LinearSolver::Dense, 1),
    ] {
        let options =
            Options { linear_solver, refinements, max_iterations: 1, ..Options::default() };
        criterion.bench_function(name, |b| {
            let made = || {
                let (problem, _) = drive();
                let solver = Solver::new(&problem, &options);
                (problem, solver)
            };
            let step = |(mut problem, solver): (Problem, Result<Solver, _>)| {
                let solved = solver.and_then(|mut solver| {
                    solver.solve(&mut problem)
                });
                assert!(solved.is_ok_and(|summary| summary.iterations.len() == 1));
            };
            b.iter_batched(made, step, BatchSize::LargeInput);
        });
    }
}

criterion_group!(benches, paths);
criterion_main!(benches);
