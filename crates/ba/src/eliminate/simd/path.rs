//! Which instructions the inner loops use.

use std::sync::OnceLock;

#[cfg(target_arch = "x86_64")]
use super::fused::{Fused, Fused512};
use super::portable::Portable;
use super::vector::{Isa, Task};

/// One of the ways in which the inner loops are compiled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Path {
    /// No instructions in particular.
    Portable,
    /// AVX2 with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Fused,
    /// AVX-512 F and VL, and the former.
    #[cfg(target_arch = "x86_64")]
    Fused512,
}

impl Path {
    /// All that this machine has, the best last.
    fn available() -> Vec<Self> {
        #[cfg_attr(not(target_arch = "x86_64"), expect(unused_mut))]
        let mut paths = vec![Self::Portable];
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            let fused = has!("avx2") && has!("fma");
            paths.extend(fused.then_some(Self::Fused));
            paths.extend((fused && has!("avx512f") && has!("avx512vl")).then_some(Self::Fused512));
        }
        paths
    }
}

#[cfg(test)]
thread_local! {
    /// In place of the best, in tests on one thread.
    static FORCED: std::cell::Cell<Option<Path>> = const { std::cell::Cell::new(None) };
}

/// The best that this machine has.
fn path() -> Path {
    static BEST: OnceLock<Path> = OnceLock::new();
    #[cfg(test)]
    if let Some(path) = FORCED.get() {
        return path;
    }
    *BEST.get_or_init(|| Path::available().last().copied().unwrap_or(Path::Portable))
}

/// Lets `task` choose what is compiled for the best instructions of this machine: what it passes to
/// [`Isa::run`].
pub(crate) fn dispatch(task: impl Task) {
    match path() {
        #[cfg(target_arch = "x86_64")]
        Path::Fused512 => task.run::<Fused512>(),
        #[cfg(target_arch = "x86_64")]
        Path::Fused => task.run::<Fused>(),
        Path::Portable => task.run::<Portable>(),
    }
}

/// Runs `task` compiled for the best instructions with vectors of at most four numbers.
pub(crate) fn run_narrow(task: impl Task) {
    match path() {
        Path::Portable => Portable::run(task),
        #[cfg(target_arch = "x86_64")]
        _ => Fused::run(task),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)] // the lint knows test functions, not their helpers
mod tests {
    use std::ops::ControlFlow;

    use nalgebra::{SVector, Vector2, Vector3};
    use tiepoint_geometry::cameras::{Opencv, Pinhole, SimplePinhole};
    use tiepoint_geometry::{CameraModel, Loss, Manifold, Rigid3, Rng};

    use super::{FORCED, Path};
    use crate::factors::{Between, Prior, Reprojection};
    use crate::{LinearSolver, Options, Order, Problem, Solver};

    /// Rounding, after a step on normal equations with a condition number of some 1e6.
    const SAME: f64 = 1e-8;
    /// Under Miri few points, and no factorisation: faer's asks the processor for its caches, which
    /// Miri does not have.
    const POINTS: usize = if cfg!(miri) { 12 } else { 60 };
    const SOLVER: LinearSolver =
        if cfg!(miri) { LinearSolver::Iterative } else { LinearSolver::Dense };

    /// The values after a step of a problem of one chunk, which stays on this thread: points seen
    /// by cameras, with blocks as wide as a pose and the parameters, or apart; factors between
    /// poses; and partly held variables.
    fn step<M: CameraModel<Params = SVector<f64, N>>, const N: usize>(
        params: [f64; N],
        shared: bool,
        path: Path,
    ) -> Vec<f64>
    where
        SVector<f64, N>: Manifold,
    {
        let (mut problem, mut rng) = (Problem::new(), Rng::stream(3, &[]));
        let params = SVector::<f64, N>::from(params);
        let true_pose = |i: usize| {
            Rigid3::from_axis_angle(
                Vector3::new(0.02, 0.05 * i as f64, 0.01),
                Vector3::new(-(i as f64), 0.1, 8.0),
            )
        };
        let lens = problem.add_parameter(params, Order::Shared);
        let cameras: Vec<_> = (0..6)
            .map(|i| {
                let pose = problem.add_parameter(true_pose(i), Order::At(i as u32));
                (
                    if shared { lens } else { problem.add_parameter(params, Order::At(i as u32)) },
                    pose,
                )
            })
            .collect();
        problem.fix(cameras[0].1);
        problem.fix_dofs(cameras[1].1, &[0, 4]).unwrap();
        problem.fix_dofs(cameras[2].0, &[1]).unwrap();
        let mut points = Vec::new();
        for j in 0..POINTS {
            let point =
                Vector3::new(rng.uniform() * 4.0, rng.uniform() * 4.0 - 2.0, rng.uniform() * 4.0);
            let key = problem.add_landmark(
                point + Vector3::new(rng.normal(), rng.normal(), rng.normal()) * 0.02,
            );
            points.push(key);
            for (i, &(lens, pose)) in cameras.iter().enumerate().skip(j % 3).take(2 + j % 4) {
                let pixel = M::project(&params, &(true_pose(i) * point)).unwrap();
                let noise = Vector2::new(rng.normal(), rng.normal()) * 0.5;
                let factor = Reprojection::<M>::new(pixel + noise, 1.0);
                problem.add((lens, pose, key), factor, Loss::Huber(1.0)).unwrap();
            }
        }
        problem.fix_dofs(points[7], &[2]).unwrap();
        let between = Between::new(true_pose(4) * true_pose(1).inverse(), &[0.01; 6]).unwrap();
        problem.add((cameras[1].1, cameras[4].1), between, Loss::Trivial).unwrap();
        let prior = Prior::new(true_pose(3), &[0.1; 6]).unwrap();
        problem.add(cameras[3].1, prior, Loss::Trivial).unwrap();
        let options = Options {
            linear_solver: SOLVER,
            max_iterations: 1,
            refinements: 0,
            ..Options::default()
        };
        FORCED.set(Some(path));
        let summary = Solver::new(&problem, &options)
            .and_then(|mut solver| solver.solve(&mut problem, &mut |_| ControlFlow::Continue(())));
        FORCED.set(None);
        let summary = summary.unwrap();
        assert!(summary.final_cost < summary.initial_cost, "{path:?} {summary}");
        let poses = cameras.iter().flat_map(|&(lens, pose)| {
            let (pose, lens) = (problem.get(pose), problem.get(lens));
            let numbers: Vec<f64> = pose.translation.iter().chain(lens.iter()).copied().collect();
            numbers.into_iter().chain([pose.rotation.angle()])
        });
        poses.chain(points.iter().flat_map(|&key| <[f64; 3]>::from(problem.get(key)))).collect()
    }

    fn all_agree<M: CameraModel<Params = SVector<f64, N>>, const N: usize>(params: [f64; N])
    where
        SVector<f64, N>: Manifold,
    {
        for shared in [false, true] {
            let [portable, others @ ..] = &Path::available()[..] else { return };
            let expected = step::<M, N>(params, shared, *portable);
            let found: Vec<_> =
                others.iter().map(|&path| step::<M, N>(params, shared, path)).collect();
            for found in &found {
                for (a, b) in expected.iter().zip(found) {
                    assert!((a - b).abs() < SAME * a.abs().max(1.0), "{a} {b}");
                }
            }
            // Their widths differ and not the order of operations.
            assert!(found.windows(2).all(|two| two[0] == two[1]));
        }
    }

    #[test]
    fn all_paths_of_this_machine_take_the_same_step() {
        all_agree::<SimplePinhole, 3>([600.0, 320.0, 240.0]);
        all_agree::<Pinhole, 4>([600.0, 600.0, 320.0, 240.0]);
        all_agree::<Opencv, 8>([600.0, 600.0, 320.0, 240.0, -0.03, 0.01, 1e-3, -1e-3]);
    }
}
