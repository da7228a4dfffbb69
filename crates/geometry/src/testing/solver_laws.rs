//! Random problems with known solutions for every solver of [`solvers::TABLE`].

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Vector2, Vector3};

use crate::solvers::{self, SolverInfo};
use crate::{Rigid3, Rng, Sim3, epipolar};

/// The accuracy of a solver on one random problem.
#[derive(Clone, Copy, Debug)]
pub struct SolverTrial {
    /// Number of solutions.
    pub solutions: usize,
    /// The largest residual of the solutions, in units of the data, which are of size 1; zero
    /// without solutions.
    pub residual: f64,
    /// The distance of the nearest solution to the true solution; infinite without solutions.
    pub distance: f64,
}

/// A random problem for a solver.
pub struct SolverProblem {
    solve: Box<dyn Fn() -> usize>,
    evaluate: Box<dyn Fn() -> SolverTrial>,
}

impl SolverProblem {
    /// A problem from the call of its solver, the residual of a solution, and the distance of a
    /// solution to the true solution.
    fn new<T, S: AsRef<[T]>>(
        solve: impl Fn() -> S + Copy + 'static,
        residual: impl Fn(&T) -> f64 + 'static,
        distance: impl Fn(&T) -> f64 + 'static,
    ) -> Self {
        let evaluate = move || {
            let solutions = solve();
            let solutions = solutions.as_ref();
            SolverTrial {
                solutions: solutions.len(),
                residual: solutions.iter().map(&residual).fold(0.0, f64::max),
                distance: solutions.iter().map(&distance).fold(f64::INFINITY, f64::min),
            }
        };
        Self { solve: Box::new(move || solve().as_ref().len()), evaluate: Box::new(evaluate) }
    }

    /// Runs the solver and returns the number of solutions. For timing.
    pub fn solve(&self) -> usize {
        (self.solve)()
    }

    /// Runs the solver and compares its solutions with the true solution.
    pub fn evaluate(&self) -> SolverTrial {
        (self.evaluate)()
    }
}

/// An optional solution as a list.
fn list<T>(solution: Option<T>) -> ArrayVec<T, 1> {
    solution.into_iter().collect()
}

/// Two cameras, and points in front of both.
struct TwoViews {
    cam2_from_cam1: Rigid3,
    points: Vec<Vector3<f64>>,
}

impl TwoViews {
    /// Random points in the 90-degree field of view of the first camera, with depths of 1 to 10,
    /// and a random second camera with the points in front of it.
    fn random(count: usize, rng: &mut Rng) -> Self {
        loop {
            let points: Vec<_> = (0..count)
                .map(|_| {
                    let depth = 1.0 + 9.0 * rng.uniform();
                    Vector3::new(uniform(rng) * depth, uniform(rng) * depth, depth)
                })
                .collect();
            let cam2_from_cam1 =
                Rigid3::from_axis_angle(direction(rng) * rng.uniform(), direction(rng));
            if points.iter().all(|p| (cam2_from_cam1 * *p).z > 0.1) {
                return Self { cam2_from_cam1, points };
            }
        }
    }

    /// Random points on a plane, in front of both cameras, and the homography of the plane.
    fn random_plane(count: usize, rng: &mut Rng) -> (Self, Matrix3<f64>) {
        loop {
            let mut views = Self::random(count, rng);
            let normal = Vector3::new(uniform(rng), uniform(rng), 1.0).normalize()
                / (1.0 + 4.0 * rng.uniform());
            for point in &mut views.points {
                *point /= normal.dot(point);
            }
            if views.points.iter().all(|p| p.z > 0.1 && (views.cam2_from_cam1 * *p).z > 0.1) {
                let pose = &views.cam2_from_cam1;
                let h = pose.rotation.to_rotation_matrix().matrix()
                    + pose.translation * normal.transpose();
                return (views, h.normalize());
            }
        }
    }

    fn rays<const N: usize>(&self) -> [[Vector3<f64>; N]; 2] {
        let ray = |pose: &Rigid3, i: usize| (*pose * self.points[i]).normalize();
        [Rigid3::identity(), self.cam2_from_cam1].map(|pose| std::array::from_fn(|i| ray(&pose, i)))
    }

    fn image_points<const N: usize>(&self) -> [[Vector2<f64>; N]; 2] {
        self.rays().map(|rays| rays.map(|ray| ray.xy() / ray.z))
    }
}

/// Uniform in [−1, 1).
fn uniform(rng: &mut Rng) -> f64 {
    2.0 * rng.uniform() - 1.0
}

/// Uniform on the sphere.
fn direction(rng: &mut Rng) -> Vector3<f64> {
    Vector3::new(rng.normal(), rng.normal(), rng.normal()).normalize()
}

/// Distance of matrices up to scale and sign.
fn projective_distance(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
    let (a, b) = (a.normalize(), b.normalize());
    (a - b).norm().min((a + b).norm())
}

fn epipolar_residual(m: &Matrix3<f64>, y1: &[Vector3<f64>], y2: &[Vector3<f64>]) -> f64 {
    y1.iter().zip(y2).map(|(y1, y2)| y2.dot(&(m.normalize() * y1)).abs()).fold(0.0, f64::max)
}

fn transfer_residual(h: &Matrix3<f64>, x1: &[Vector2<f64>], x2: &[Vector2<f64>]) -> f64 {
    let error = |x1: &Vector2<f64>, x2: &Vector2<f64>| {
        let y = h * x1.push(1.0);
        // Without division by the depth, which would amplify the error of small depths.
        (y.xy() - x2 * y.z).norm() / h.norm()
    };
    x1.iter().zip(x2).map(|(x1, x2)| error(x1, x2)).fold(0.0, f64::max)
}

/// A random problem for a solver of [`solvers::TABLE`]; `None` if the solver has no generator.
pub fn solver_problem(info: &SolverInfo, rng: &mut Rng) -> Option<SolverProblem> {
    Some(match info.name {
        "p3p" => {
            let views = TwoViews::random(3, rng);
            let ([_, rays], truth) = (views.rays::<3>(), views.cam2_from_cam1);
            let points = [views.points[0], views.points[1], views.points[2]];
            let residual = move |pose: &Rigid3| {
                let error = |i: usize| (*pose * points[i]).normalize() - rays[i];
                (0..3).map(|i| error(i).norm()).fold(0.0, f64::max)
            };
            let distance = move |pose: &Rigid3| {
                pose.rotation.angle_to(&truth.rotation)
                    + (pose.translation - truth.translation).norm()
            };
            SolverProblem::new(move || solvers::p3p(&rays, &points), residual, distance)
        }
        "gp3p" => {
            let views = TwoViews::random(3, rng);
            let (truth, points) = (views.cam2_from_cam1, views.points);
            let points = [points[0], points[1], points[2]];
            // Each ray is of a camera of its own, at a distance of up to 1 from the origin.
            let origins = points.map(|_| direction(rng) * rng.uniform());
            let ray = |i: usize| (truth * points[i] - origins[i]).normalize();
            let rays = [ray(0), ray(1), ray(2)];
            let residual = move |pose: &Rigid3| {
                let error = |i: usize| (*pose * points[i] - origins[i]).normalize() - rays[i];
                (0..3).map(|i| error(i).norm()).fold(0.0, f64::max)
            };
            let distance = move |pose: &Rigid3| {
                pose.rotation.angle_to(&truth.rotation)
                    + (pose.translation - truth.translation).norm()
            };
            let solve = move || solvers::gp3p(&origins, &rays, &points);
            SolverProblem::new(solve, residual, distance)
        }
        "essential_5pt" => {
            let views = TwoViews::random(5, rng);
            let [rays1, rays2] = views.rays::<5>();
            let truth = epipolar::essential_from_pose(&views.cam2_from_cam1);
            let residual = move |e: &Matrix3<f64>| {
                // Norm √2: singular values are 1, 1, 0 where 2EEᵀE = tr(EEᵀ)E.
                let cubic = e * e.transpose() * e * 2.0 - e * (e * e.transpose()).trace();
                cubic.norm().max(e.determinant().abs()).max(epipolar_residual(e, &rays1, &rays2))
            };
            let solve = move || solvers::essential_5pt(&rays1, &rays2);
            SolverProblem::new(solve, residual, move |e| projective_distance(e, &truth))
        }
        "fundamental_7pt" => {
            let (x1, x2, truth) = fundamental_problem::<7>(rng);
            let solve = move || solvers::fundamental_7pt(&x1, &x2);
            let residual = move |f: &Matrix3<f64>| fundamental_residual(f, &x1, &x2);
            SolverProblem::new(solve, residual, move |f| projective_distance(f, &truth))
        }
        "fundamental_8pt" => {
            let (x1, x2, truth) = fundamental_problem::<8>(rng);
            let solve = move || list(solvers::fundamental_8pt(&x1, &x2));
            let residual = move |f: &Matrix3<f64>| fundamental_residual(f, &x1, &x2);
            SolverProblem::new(solve, residual, move |f| projective_distance(f, &truth))
        }
        "homography_4pt" | "homography_dlt" => {
            let is_minimal = info.name == "homography_4pt";
            let (views, truth) = TwoViews::random_plane(4, rng);
            let [x1, x2] = views.image_points::<4>();
            let solve = move || {
                list(if is_minimal {
                    solvers::homography_4pt(&x1, &x2)
                } else {
                    solvers::homography_dlt(&x1, &x2)
                })
            };
            let residual = move |h: &Matrix3<f64>| transfer_residual(h, &x1, &x2);
            SolverProblem::new(solve, residual, move |h| projective_distance(h, &truth))
        }
        "umeyama" => {
            let scale = rng.normal().exp();
            let pose =
                Rigid3::from_axis_angle(direction(rng) * 3.1 * rng.uniform(), direction(rng));
            let truth = Sim3 { scale, rotation: pose.rotation, translation: pose.translation };
            let from: [Vector3<f64>; 3] = std::array::from_fn(|_| direction(rng) * rng.uniform());
            let to = from.map(|p| truth * p);
            let residual = move |s: &Sim3| {
                from.iter().zip(&to).map(|(from, to)| (*s * *from - to).norm()).fold(0.0, f64::max)
                    / s.scale
            };
            let distance = move |s: &Sim3| {
                let rotation = s.rotation.angle_to(&truth.rotation);
                rotation
                    + (s.translation - truth.translation).norm()
                    + (s.scale / truth.scale).ln().abs()
            };
            SolverProblem::new(move || list(solvers::umeyama(&from, &to, true)), residual, distance)
        }
        _ => return None,
    })
}

fn fundamental_problem<const N: usize>(
    rng: &mut Rng,
) -> ([Vector2<f64>; N], [Vector2<f64>; N], Matrix3<f64>) {
    let views = TwoViews::random(N, rng);
    let [x1, x2] = views.image_points::<N>();
    (x1, x2, epipolar::essential_from_pose(&views.cam2_from_cam1))
}

fn fundamental_residual(f: &Matrix3<f64>, x1: &[Vector2<f64>], x2: &[Vector2<f64>]) -> f64 {
    let homogeneous = |x: &[Vector2<f64>]| x.iter().map(|x| x.push(1.0)).collect::<Vec<_>>();
    f.determinant().abs().max(epipolar_residual(f, &homogeneous(x1), &homogeneous(x2)))
}
