//! Run-time choice of the instruction set of the inner loops.

use tiepoint_simd::Level;

#[cfg(target_arch = "x86_64")]
use super::fused::{Fused, Fused512};
use super::portable::Portable;
use super::vector::{Isa, Kernel};

#[cfg(test)]
thread_local! {
    /// Replaces the best one in tests on one thread.
    static FORCED: std::cell::Cell<Option<tiepoint_simd::Isa>> =
        const { std::cell::Cell::new(None) };
}

/// The best one that this processor has.
fn best() -> Level {
    #[cfg(test)]
    if let Some(isa) = FORCED.get() {
        return isa.level();
    }
    tiepoint_simd::Isa::best().level()
}

/// Runs `kernel`, which passes the loops that are to be compiled for the best instruction set to
/// [`Isa::run`].
pub(crate) fn dispatch(kernel: impl Kernel) {
    match best() {
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => kernel.run::<Fused512>(),
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => kernel.run::<Fused>(),
        Level::Portable => kernel.run::<Portable>(),
    }
}

/// Runs `kernel` compiled for the best instruction set with vectors of at most four numbers.
pub(crate) fn run_narrow(kernel: impl Kernel) {
    match best() {
        Level::Portable => Portable::run(kernel),
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 | Level::Avx2 => Fused::run(kernel),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)] // the lint knows test functions, not their helpers
mod tests {

    use nalgebra::{SVector, Vector2, Vector3};
    use tiepoint_geometry::cameras::{Opencv, Pinhole, SimplePinhole};
    use tiepoint_geometry::{CameraModel, Loss, Manifold, Rigid3, Rng};

    use tiepoint_simd::Isa;

    use super::FORCED;
    use crate::factors::{Between, Prior, Reprojection};
    use crate::{EliminationOrder, LinearSolver, Options, Problem, Solver};

    /// Rounding, after a step on normal equations with a condition number of about 1e6.
    const SAME: f64 = 1e-8;
    /// Miri is slow, and does not support the query for cache sizes in faer's factorisation.
    const POINTS: usize = if cfg!(miri) { 12 } else { 60 };
    const SOLVER: LinearSolver =
        if cfg!(miri) { LinearSolver::Iterative } else { LinearSolver::Dense };

    /// The values after one step of a problem with one task, which stays on this thread. Points are
    /// seen by cameras whose pose and intrinsics are one merged block, or separate ones if
    /// `shared`; some factors join two poses; some variables are partly fixed.
    fn step<M: CameraModel<Params = SVector<f64, N>>, const N: usize>(
        params: [f64; N],
        shared: bool,
        set: Isa,
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
        let intrinsics = problem.add_parameter(params, EliminationOrder::Last);
        let cameras: Vec<_> = (0..6)
            .map(|i| {
                let pose = problem.add_parameter(true_pose(i), EliminationOrder::At(i as u32));
                (
                    if shared {
                        intrinsics
                    } else {
                        problem.add_parameter(params, EliminationOrder::At(i as u32))
                    },
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
            for (i, &(intrinsics, pose)) in cameras.iter().enumerate().skip(j % 3).take(2 + j % 4) {
                let pixel = M::project(&params, &(true_pose(i) * point)).unwrap();
                let noise = Vector2::new(rng.normal(), rng.normal()) * 0.5;
                let factor = Reprojection::<M>::new(pixel + noise, 1.0);
                problem.add((intrinsics, pose, key), factor, Loss::Huber(1.0)).unwrap();
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
        FORCED.set(Some(set));
        let summary =
            Solver::new(&problem, &options).and_then(|mut solver| solver.solve(&mut problem));
        FORCED.set(None);
        let summary = summary.unwrap();
        assert!(summary.final_cost < summary.initial_cost, "{set:?} {summary}");
        let poses = cameras.iter().flat_map(|&(intrinsics, pose)| {
            let (pose, intrinsics) = (problem.get(pose), problem.get(intrinsics));
            let numbers: Vec<f64> =
                pose.translation.iter().chain(intrinsics.iter()).copied().collect();
            numbers.into_iter().chain([pose.rotation.angle()])
        });
        poses.chain(points.iter().flat_map(|&key| <[f64; 3]>::from(problem.get(key)))).collect()
    }

    fn all_agree<M: CameraModel<Params = SVector<f64, N>>, const N: usize>(params: [f64; N])
    where
        SVector<f64, N>: Manifold,
    {
        for shared in [false, true] {
            let [others @ .., portable] = &Isa::available()[..] else { return };
            let expected = step::<M, N>(params, shared, *portable);
            let found: Vec<_> =
                others.iter().map(|&set| step::<M, N>(params, shared, set)).collect();
            for found in &found {
                for (a, b) in expected.iter().zip(found) {
                    assert!((a - b).abs() < SAME * a.abs().max(1.0), "{a} {b}");
                }
            }
            // They differ in width, not in the order of operations.
            assert!(found.windows(2).all(|two| two[0] == two[1]));
        }
    }

    #[test]
    fn all_instruction_sets_take_the_same_step() {
        all_agree::<SimplePinhole, 3>([600.0, 320.0, 240.0]);
        all_agree::<Pinhole, 4>([600.0, 600.0, 320.0, 240.0]);
        all_agree::<Opencv, 8>([600.0, 600.0, 320.0, 240.0, -0.03, 0.01, 1e-3, -1e-3]);
    }
}
