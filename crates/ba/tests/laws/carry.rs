//! A long chain that is bent and grows, as drift leaves it, straightens in few steps when what
//! hangs together is carried along.

use tiepoint_ba::factors::Reprojection;
use tiepoint_ba::nalgebra::{Vector2, Vector3, Vector4};
use tiepoint_ba::{Key, Loss, Order, Problem, SpanningTree};
use tiepoint_geometry::cameras::Pinhole;
use tiepoint_geometry::{CameraModel, Rigid3, Rng, so3};

use crate::scene::solve_as;

const MOMENTS: usize = 120;
const POINTS: usize = 20;
/// A point is seen by so many images in a row.
const SIGHT: usize = 5;
const STEP_M: f64 = 1.0;
const NOISE_PX: f64 = 0.3;
const LENS: [f64; 4] = [600.0, 600.0, 400.0, 300.0];
/// By image, the chain begins bent by this angle and grown by this factor: 55 degrees and 1.8 times
/// from one end to the other.
const BEND_RAD: f64 = 0.008;
const GROWTH: f64 = 1.005;
/// Carried it takes 8 steps, and in straight lines 25, of which 10 go wrong.
const FEW: usize = 12;
/// Costs of the same minimum agree to where the last step ends a solve.
const SAME_COST: f64 = 1e-5;

/// Which pose sees which point.
type Sight = (Key<Rigid3>, Key<Vector3<f64>>);

/// Cameras that drive along x and look aside, begun bent and grown from the first one on; and which
/// of them sees which point.
fn bent_chain() -> (Problem, Vec<Sight>) {
    let mut rng = Rng::stream(3, &[]);
    let mut problem = Problem::new();
    let lens = problem.add_parameter(Vector4::from(LENS), Order::Shared);
    problem.fix(lens);
    let truth: Vec<Rigid3> = (0..MOMENTS)
        .map(|i| {
            Rigid3::from_axis_angle(Vector3::zeros(), Vector3::new(-STEP_M * i as f64, 0.0, 0.0))
        })
        .collect();
    // Each relative pose is a bit wrong, always in the same way.
    let mut start = vec![truth[0]];
    for i in 1..MOMENTS {
        let mut relative = truth[i] * truth[i - 1].inverse();
        relative.rotation = so3::exp(&Vector3::new(0.0, BEND_RAD, 0.0)) * relative.rotation;
        relative.translation *= GROWTH.powi(i as i32);
        start.push(relative * start[i - 1]);
    }
    let poses: Vec<_> =
        (0u32..).zip(&start).map(|(i, pose)| problem.add_parameter(*pose, Order::At(i))).collect();
    problem.fix(poses[0]);
    problem.fix_dofs(poses[MOMENTS - 1], &[3]).unwrap();
    let mut sights = Vec::new();
    for i in 0..MOMENTS {
        for _ in 0..POINTS {
            let [x, y, z] = [0; 3].map(|_| rng.uniform());
            let seen = Vector3::new(6.0 * x - 1.0, 6.0 * y - 3.0, 5.0 + 6.0 * z);
            let point = truth[i].inverse() * seen;
            let key = problem.add_landmark(start[i].inverse() * (seen * GROWTH.powi(i as i32)));
            for k in i..(i + SIGHT).min(MOMENTS) {
                let Some(pixel) = Pinhole::project(&LENS.into(), &(truth[k] * point)) else {
                    continue;
                };
                let pixel = pixel + Vector2::new(rng.normal(), rng.normal()) * NOISE_PX;
                let factor = Reprojection::<Pinhole>::new(pixel, NOISE_PX);
                problem.add((lens, poses[k], key), factor, Loss::Trivial).unwrap();
                sights.push((poses[k], key));
            }
        }
    }
    (problem, sights)
}

#[test]
fn a_bent_chain_straightens_in_few_steps() {
    let (mut problem, sights) = bent_chain();
    let tree = SpanningTree::new(&problem, &sights).unwrap();
    problem.set_retraction(tree);
    let carried = solve_as(&mut problem, &Default::default());
    assert!(carried.termination.converged() && carried.iterations.len() <= FEW, "{carried}");

    let (mut problem, _) = bent_chain();
    let straight = solve_as(&mut problem, &Default::default());
    assert!(straight.iterations.len() > FEW, "{straight}");
    assert!(carried.final_cost < (1.0 + SAME_COST) * straight.final_cost, "{carried}\n{straight}");
}
