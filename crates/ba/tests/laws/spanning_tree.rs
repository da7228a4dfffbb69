//! A long chain of poses with drift in rotation and scale converges in few steps with the relative
//! retraction.

use tiepoint_ba::factors::Reprojection;
use tiepoint_ba::nalgebra::{Vector2, Vector3, Vector4};
use tiepoint_ba::{EliminationOrder, Key, Loss, Problem, SpanningTree};
use tiepoint_geometry::cameras::Pinhole;
use tiepoint_geometry::{CameraModel, Rigid3, Rng, so3};

use crate::scene::solve_as;

const FRAMES: usize = 120;
const POINTS: usize = 20;
/// Number of consecutive images that see a point.
const TRACK_LENGTH: usize = 5;
const STEP_M: f64 = 1.0;
const NOISE_PX: f64 = 0.3;
const INTRINSICS: [f64; 4] = [600.0, 600.0, 400.0, 300.0];
/// Initial errors of each relative pose, rotation and scale: 55 degrees and 1.8 times from one end
/// to the other.
const BEND_RAD: f64 = 0.008;
const SCALING: f64 = 1.005;
/// The relative retraction takes 8 steps; without it there are 25, of which 10 are rejected.
const MAX_STEPS: usize = 12;
/// Relative difference of the costs of the same minimum, given the function tolerance.
const SAME_COST: f64 = 1e-5;

/// Pose and point of an observation.
type Observation = (Key<Rigid3>, Key<Vector3<f64>>);

/// Cameras that drive along x and look sideways, with initial drift from the first one on, and
/// their observations.
fn bent_chain() -> (Problem, Vec<Observation>) {
    let mut rng = Rng::stream(3, &[]);
    let mut problem = Problem::new();
    let intrinsics = problem.add_parameter(Vector4::from(INTRINSICS), EliminationOrder::Last);
    problem.fix(intrinsics);
    let truth: Vec<Rigid3> = (0..FRAMES)
        .map(|i| {
            Rigid3::from_axis_angle(Vector3::zeros(), Vector3::new(-STEP_M * i as f64, 0.0, 0.0))
        })
        .collect();
    // Each relative pose has the same error.
    let mut start = vec![truth[0]];
    for i in 1..FRAMES {
        let mut relative = truth[i] * truth[i - 1].inverse();
        relative.rotation = so3::exp(&Vector3::new(0.0, BEND_RAD, 0.0)) * relative.rotation;
        relative.translation *= SCALING.powi(i as i32);
        start.push(relative * start[i - 1]);
    }
    let poses: Vec<_> = (0u32..)
        .zip(&start)
        .map(|(i, pose)| problem.add_parameter(*pose, EliminationOrder::At(i)))
        .collect();
    problem.fix(poses[0]);
    problem.fix_dofs(poses[FRAMES - 1], &[3]).unwrap();
    let mut observations = Vec::new();
    for i in 0..FRAMES {
        for _ in 0..POINTS {
            let [x, y, z] = [0; 3].map(|_| rng.uniform());
            let seen = Vector3::new(6.0 * x - 1.0, 6.0 * y - 3.0, 5.0 + 6.0 * z);
            let point = truth[i].inverse() * seen;
            let key = problem.add_landmark(start[i].inverse() * (seen * SCALING.powi(i as i32)));
            for k in i..(i + TRACK_LENGTH).min(FRAMES) {
                let Some(pixel) = Pinhole::project(&INTRINSICS.into(), &(truth[k] * point)) else {
                    continue;
                };
                let pixel = pixel + Vector2::new(rng.normal(), rng.normal()) * NOISE_PX;
                let factor = Reprojection::<Pinhole>::new(pixel, NOISE_PX);
                problem.add((intrinsics, poses[k], key), factor, Loss::Trivial).unwrap();
                observations.push((poses[k], key));
            }
        }
    }
    (problem, observations)
}

#[test]
fn a_bent_chain_straightens_in_few_steps() {
    let (mut problem, observations) = bent_chain();
    let tree = SpanningTree::new(&problem, &observations).unwrap();
    problem.set_retraction(tree);
    let relative = solve_as(&mut problem, &Default::default());
    assert!(
        relative.termination.converged() && relative.iterations.len() <= MAX_STEPS,
        "{relative}"
    );

    let (mut problem, _) = bent_chain();
    let straight = solve_as(&mut problem, &Default::default());
    assert!(straight.iterations.len() > MAX_STEPS, "{straight}");
    assert!(
        relative.final_cost < (1.0 + SAME_COST) * straight.final_cost,
        "{relative}\n{straight}"
    );
}
