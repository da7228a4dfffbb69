//! A synthetic scene: cameras on an arc that look at a cloud of points.

use tiepoint_ba::factors::Reprojection;
use tiepoint_ba::nalgebra::{Vector2, Vector3, Vector4};
use tiepoint_ba::{EliminationOrder, Key, LinearSolver, Loss, Options, Problem, Solver, Summary};
use tiepoint_geometry::cameras::SimpleRadial;
use tiepoint_geometry::{CameraModel, Rigid3, Rng};

/// Sharing of intrinsics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Intrinsics {
    OneEach,
    Shared,
}

/// The problem and the keys of its variables.
pub(crate) struct Scene {
    pub(crate) problem: Problem,
    pub(crate) intrinsics: Vec<Key<Vector4<f64>>>,
    pub(crate) poses: Vec<Key<Rigid3>>,
    pub(crate) points: Vec<Key<Vector3<f64>>>,
    pub(crate) true_poses: Vec<Rigid3>,
    pub(crate) true_points: Vec<Vector3<f64>>,
}

/// Measurement noise, and initial errors of poses (radians, units) and points in a scene of about
/// ten units.
pub(crate) const NOISE_PX: f64 = 0.5;
const POSE_PERTURBATION: f64 = 0.02;
const POINT_PERTURBATION: f64 = 0.05;
/// f, cx, cy, k of all cameras.
pub(crate) const PARAMS: [f64; 4] = [600.0, 320.0, 240.0, -0.03];

fn symmetric(rng: &mut Rng) -> f64 {
    2.0 * rng.uniform() - 1.0
}

fn vector(rng: &mut Rng, max: f64) -> Vector3<f64> {
    Vector3::new(symmetric(rng), symmetric(rng), symmetric(rng)) * max
}

impl Scene {
    /// Point j belongs to camera j · `cameras` / `points`. Cameras within `window` of that one see
    /// it with probability `share`, those within 2 (and `window`) always.
    pub(crate) fn new(
        cameras: usize,
        points: usize,
        share: f64,
        window: usize,
        intrinsics: Intrinsics,
        noise_px: f64,
    ) -> Self {
        let mut rng = Rng::stream(7, &[0]);
        let mut problem = Problem::new();
        let true_poses: Vec<Rigid3> = (0..cameras)
            .map(|i| {
                let angle = 1.5 * (i as f64 / cameras as f64 - 0.5);
                let turn = Vector3::new(0.0, angle, 0.0) + vector(&mut rng, 0.05);
                Rigid3::from_axis_angle(turn, Vector3::new(0.0, 0.0, 12.0) + vector(&mut rng, 0.5))
            })
            .collect();
        let true_points: Vec<Vector3<f64>> = (0..points).map(|_| vector(&mut rng, 4.0)).collect();
        let num_intrinsics = if intrinsics == Intrinsics::Shared { 1 } else { cameras };
        let start = Vector4::from(PARAMS) + Vector4::new(5.0, 0.0, 0.0, 0.01);
        let intrinsics: Vec<_> = (0..num_intrinsics)
            .map(|i| {
                let order = if num_intrinsics == 1 {
                    EliminationOrder::Last
                } else {
                    EliminationOrder::At(i as u32)
                };
                problem.add_parameter(start, order)
            })
            .collect();
        let poses: Vec<_> = true_poses
            .iter()
            .enumerate()
            .map(|(i, pose)| {
                let perturbation = Rigid3::from_axis_angle(
                    vector(&mut rng, POSE_PERTURBATION),
                    vector(&mut rng, POSE_PERTURBATION),
                );
                problem.add_parameter(
                    if i == 0 { *pose } else { perturbation * *pose },
                    EliminationOrder::At(i as u32),
                )
            })
            .collect();
        let keys: Vec<_> = true_points
            .iter()
            .map(|point| problem.add_landmark(point + vector(&mut rng, POINT_PERTURBATION)))
            .collect();
        for (j, point) in true_points.iter().enumerate() {
            let first = j * cameras / points;
            for i in 0..cameras {
                let near = i.abs_diff(first) <= window;
                if !(near && (rng.uniform() < share || i.abs_diff(first) <= 2)) {
                    continue;
                }
                let pixel =
                    SimpleRadial::project(&PARAMS.into(), &(true_poses[i] * *point)).unwrap();
                let pixel =
                    pixel + Vector2::new(symmetric(&mut rng), symmetric(&mut rng)) * noise_px;
                let factor = Reprojection::<SimpleRadial>::new(pixel, 1.0);
                let params = intrinsics[i.min(num_intrinsics - 1)];
                problem.add((params, poses[i], keys[j]), factor, Loss::Trivial).unwrap();
            }
        }
        Self { problem, intrinsics, poses, points: keys, true_poses, true_points }
    }

    /// Fixes the first pose, and the second one's translation along its optical axis, which is
    /// mostly the scale.
    pub(crate) fn fix_gauge(&mut self) {
        self.problem.fix(self.poses[0]);
        self.problem.fix_dofs(self.poses[1], &[5]).unwrap();
    }
}

/// Solves without landmark refinement, so that linear solvers can be compared step by step.
pub(crate) fn solve(
    problem: &mut Problem,
    linear_solver: LinearSolver,
    max_iterations: usize,
) -> Summary {
    solve_as(
        problem,
        &Options { linear_solver, max_iterations, refinements: 0, ..Options::default() },
    )
}

pub(crate) fn solve_as(problem: &mut Problem, options: &Options) -> Summary {
    Solver::new(problem, options).unwrap().solve(problem).unwrap()
}
