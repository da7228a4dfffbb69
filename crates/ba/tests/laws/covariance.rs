//! Covariances, compared with a problem without elimination, with a textbook formula, and with the
//! scatter of estimates; and errors for undetermined variables.

use proptest::prelude::*;
use tiepoint_ba::autodiff::{AutoDiff, Residual, Scalar};
use tiepoint_ba::factors::{Prior, Reprojection, RigReprojection};
use tiepoint_ba::nalgebra::{DMatrix, Vector2, Vector3, Vector4};
use tiepoint_ba::{AnyKey, EliminationOrder, Error, Key, LinearSolver, Loss, Problem};
use tiepoint_geometry::cameras::SimpleRadial;
use tiepoint_geometry::{CameraModel, Rigid3, Rng};

use crate::scene::{Intrinsics, NOISE_PX, PARAMS, Scene, solve};

/// Rounding times the condition number of a small bundle adjustment.
const SAME: f64 = 1e-7;

/// A line fit to samples with unit noise: the covariance of (slope, offset) is the inverse of [Σx²,
/// Σx; Σx, n].
struct Line(f64);
impl Residual<1> for Line {
    type Vars = (Vector2<f64>,);
    fn residual<T: Scalar>(&self, ([m, c],): ([T; 2],)) -> Option<[T; 1]> {
        Some([m * self.0 + c])
    }
}

#[test]
fn line_fit_has_the_textbook_covariance() {
    let mut problem = Problem::new();
    let line = problem.add_parameter(Vector2::zeros(), EliminationOrder::Last);
    let (n, mut sum, mut squares) = (10.0, 0.0, 0.0);
    for i in 0..10 {
        let x = f64::from(i);
        problem.add(line, AutoDiff(Line(x)), Loss::Trivial).unwrap();
        (sum, squares) = (sum + x, squares + x * x);
    }
    let expected =
        DMatrix::from_row_slice(2, 2, &[n, -sum, -sum, squares]) / (n * squares - sum * sum);
    let found = problem.covariance(&[line.into()]).unwrap().of(line).unwrap();
    assert!((found - expected).amax() < 1e-12);
    // With a fixed offset, the slope's variance is 1/Σx².
    problem.fix_dofs(line, &[1]).unwrap();
    let found = problem.covariance(&[line.into()]).unwrap().of(line).unwrap();
    assert!(
        (found - DMatrix::from_row_slice(2, 2, &[1.0 / squares, 0.0, 0.0, 0.0])).amax() < 1e-12
    );
    assert_eq!(problem.covariance(&[]).unwrap().matrix().shape(), (0, 0));
}

/// The same factors with points that are kept.
fn without_elimination(scene: &Scene) -> (Problem, Vec<AnyKey>) {
    let mut twin = Problem::new();
    let (old, mut keys) = (&scene.problem, Vec::new());
    let params = twin.add_parameter(old.get(scene.intrinsics[0]), EliminationOrder::Last);
    keys.push(params.into());
    let poses: Vec<_> = scene
        .poses
        .iter()
        .map(|&key| twin.add_parameter(old.get(key), EliminationOrder::At(0)))
        .collect();
    keys.extend(poses.iter().map(|&key| AnyKey::from(key)));
    let points: Vec<_> = scene
        .points
        .iter()
        .map(|&key| twin.add_parameter(old.get(key), EliminationOrder::At(1)))
        .collect();
    keys.extend(points.iter().map(|&key| AnyKey::from(key)));
    for &point in &points {
        for &pose in &poses {
            // A covariance does not depend on the measured pixel.
            let factor = Reprojection::<SimpleRadial>::new(Vector2::zeros(), 1.0);
            twin.add((params, pose, point), factor, Loss::Trivial).unwrap();
        }
    }
    twin.fix(poses[0]);
    twin.fix_dofs(poses[1], &[5]).unwrap();
    twin.fix(points[2]);
    twin.fix_dofs(points[4], &[0, 2]).unwrap();
    (twin, keys)
}

#[test]
fn eliminated_variables_have_the_covariance_of_kept_ones() {
    // All four cameras see all points.
    let mut scene = Scene::new(4, 12, 1.0, 4, Intrinsics::Shared, NOISE_PX);
    scene.fix_gauge();
    scene.problem.fix(scene.points[2]);
    scene.problem.fix_dofs(scene.points[4], &[0, 2]).unwrap();
    solve(&mut scene.problem, LinearSolver::Auto, 5);
    let mut keys = vec![scene.intrinsics[0].into()];
    keys.extend(scene.poses.iter().map(|&key| AnyKey::from(key)));
    keys.extend(scene.points.iter().map(|&key| AnyKey::from(key)));
    let found = scene.problem.covariance(&keys).unwrap();
    let (twin, twin_keys) = without_elimination(&scene);
    let expected = twin.covariance(&twin_keys).unwrap();
    let difference = (found.matrix() - expected.matrix()).amax();
    assert!(difference < SAME * expected.matrix().amax(), "{difference}");
    // Fixed variables have zero covariance. Two requests give the same covariance.
    assert_eq!(found.of(scene.poses[0]).unwrap().amax(), 0.0);
    assert_eq!(found.of(scene.points[2]).unwrap().amax(), 0.0);
    let partly = found.of(scene.points[4]).unwrap();
    assert!(partly[(1, 1)] > 0.0 && partly[(0, 0)] == 0.0 && partly[(2, 1)] == 0.0);
    let cross = found.between(scene.poses[2], scene.points[5]).unwrap();
    assert_eq!(cross.shape(), (6, 3));
    assert!(
        (cross - found.between(scene.points[5], scene.poses[2]).unwrap().transpose()).amax() < SAME
    );
    let few = scene.problem.covariance(&[scene.points[5].into()]).unwrap();
    assert!(
        (few.matrix() - found.of(scene.points[5]).unwrap()).amax() < SAME * few.matrix().amax()
    );
    assert_eq!(few.of(scene.poses[2]), None);
}

#[test]
fn without_a_fixed_gauge_it_is_an_error() {
    let scene = Scene::new(4, 12, 1.0, 4, Intrinsics::Shared, NOISE_PX);
    for key in [scene.poses[2].into(), scene.points[3].into()] {
        let error = scene.problem.covariance(&[key]).unwrap_err();
        assert!(matches!(error, Error::Undetermined { .. }), "{error}");
    }
    let mut problem = Problem::new();
    let (alone, known) = (
        problem.add_parameter(1.0, EliminationOrder::Last),
        problem.add_parameter(2.0, EliminationOrder::Last),
    );
    let point = problem.add_landmark(Vector3::zeros());
    problem.add(known, Prior::new(2.0, &[0.5]).unwrap(), Loss::Trivial).unwrap();
    assert!(matches!(
        problem.covariance(&[alone.into()]),
        Err(Error::Undetermined { slot: 0, .. })
    ));
    assert!(matches!(
        problem.covariance(&[point.into()]),
        Err(Error::Undetermined { slot: 0, .. })
    ));
    assert!((problem.covariance(&[known.into()]).unwrap().matrix()[(0, 0)] - 0.25).abs() < 1e-12);
    let strange: Key<f64> = {
        let mut other = Problem::new();
        (0..3).map(|_| other.add_parameter(0.0, EliminationOrder::Last)).last().unwrap()
    };
    assert!(matches!(
        problem.covariance(&[strange.into()]),
        Err(Error::UnknownVariable { slot: 2, .. })
    ));
}

/// A step from one place to another, measured along both axes, or along x alone.
struct Step {
    has_y: bool,
}
impl Residual<2> for Step {
    type Vars = (Vector2<f64>, Vector2<f64>);
    fn residual<T: Scalar>(&self, (a, b): ([T; 2], [T; 2])) -> Option<[T; 2]> {
        let y = if self.has_y { 1.0 } else { 0.0 };
        Some([b[0] - a[0], (b[1] - a[1]) * y])
    }
}

/// Largest component of a vector of the null space for a variable that it does not move.
const ROUNDING: f64 = 1e-9;

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64,
        failure_persistence: None,
        ..Default::default()
    })]

    /// Places that are connected by steps, some of which are known: where the system cannot be
    /// solved, the variable that is named is moved by the null space of J, which the singular value
    /// decomposition of nalgebra gives, whichever variable is asked for.
    #[test]
    fn the_variable_that_is_named_is_undetermined(
        steps in prop::collection::vec((0..6usize, 0..6usize, any::<bool>()), 3..14),
        known in prop::collection::btree_set(0..6usize, 1..4),
    ) {
        let mut problem = Problem::new();
        let places: Vec<_> = (0..6)
            .map(|_| problem.add_parameter(Vector2::zeros(), EliminationOrder::Last))
            .collect();
        let mut rows: Vec<[f64; 12]> = Vec::new();
        let mut row = |entries: &[(usize, f64)]| {
            let mut row = [0.0; 12];
            entries.iter().for_each(|(column, value)| row[*column] = *value);
            rows.push(row);
        };
        for &(a, b, has_y) in steps.iter().filter(|(a, b, _)| a != b) {
            problem.add((places[a], places[b]), AutoDiff(Step { has_y }), Loss::Trivial).unwrap();
            for axis in 0..1 + usize::from(has_y) {
                row(&[(2 * a + axis, -1.0), (2 * b + axis, 1.0)]);
            }
        }
        for &k in &known {
            let prior = Prior::new(Vector2::zeros(), &[1.0; 2]).unwrap();
            problem.add(places[k], prior, Loss::Trivial).unwrap();
            (0..2).for_each(|axis| row(&[(2 * k + axis, 1.0)]));
        }
        let jacobian = DMatrix::from_fn(rows.len().max(12), 12, |i, j| {
            rows.get(i).map_or(0.0, |row| row[j])
        });
        let svd = jacobian.svd(false, true);
        let directions = svd.v_t.unwrap();
        let null: Vec<_> = (0..12).filter(|&k| svd.singular_values[k] < ROUNDING).collect();
        let is_moved = |slot: usize| {
            null.iter().any(|&k| directions.view((k, 2 * slot), (1, 2)).amax() > ROUNDING)
        };
        for (asked, key) in places.iter().enumerate() {
            match problem.covariance(&[(*key).into()]) {
                Err(Error::Undetermined { slot, .. }) => {
                    prop_assert!(is_moved(slot as usize), "{slot} for {asked}: {null:?}");
                }
                Err(error) => prop_assert!(false, "{error}"),
                Ok(_) => prop_assert!(!is_moved(asked), "{asked}"),
            }
        }
    }
}

/// A pose with one observation, and a point with one, are named, whichever variable is asked for.
#[test]
fn variables_with_one_observation_are_named() {
    for is_pose in [true, false] {
        let mut scene = Scene::new(4, 12, 1.0, 4, Intrinsics::Shared, NOISE_PX);
        scene.fix_gauge();
        let (params, seen) = (scene.intrinsics[0], scene.points[0]);
        let (sees, known) = (scene.poses[2], AnyKey::from(scene.poses[3]));
        let problem = &mut scene.problem;
        let factor = Reprojection::<SimpleRadial>::new(Vector2::zeros(), NOISE_PX);
        let lone: AnyKey = if is_pose {
            let pose = problem.add_parameter(problem.get(sees), EliminationOrder::At(0));
            problem.add((params, pose, seen), factor, Loss::Trivial).unwrap();
            pose.into()
        } else {
            let point = problem.add_landmark(problem.get(seen));
            problem.add((params, sees, point), factor, Loss::Trivial).unwrap();
            point.into()
        };
        let of_lone = problem.covariance(&[lone]).unwrap_err();
        let number = if is_pose { scene.poses.len() } else { scene.points.len() };
        assert!(of_lone.to_string().contains(&format!("number {number},")), "{of_lone}");
        match problem.covariance(&[known]) {
            Err(error) => assert_eq!(error, of_lone),
            // A point on its ray takes no part in the reduced system.
            Ok(covariance) => assert!(!is_pose && covariance.matrix().amax().is_finite()),
        }
    }
}

/// The covariance of rig extrinsics matches their scatter about the truth over many samples of the
/// noise.
#[test]
fn rig_covariance_matches_the_scatter_of_estimates() {
    /// Mean of χ² with 6 degrees of freedom over this many runs: 6 ± √(12 / RUNS), within 4
    /// standard deviations.
    const RUNS: u32 = 60;
    let cam_from_rig =
        Rigid3::from_axis_angle(Vector3::new(0.02, -0.1, 0.01), Vector3::new(-0.5, 0.02, 0.05));
    let mut total = 0.0;
    for run in 0..RUNS {
        let mut rng = Rng::stream(11, &[u64::from(run)]);
        let mut problem = Problem::new();
        let true_params = Vector4::from(PARAMS);
        let params = problem.add_parameter(true_params, EliminationOrder::Last);
        problem.fix(params);
        let first = problem.add_parameter(Rigid3::identity(), EliminationOrder::Last);
        problem.fix(first);
        let second = problem.add_parameter(cam_from_rig, EliminationOrder::Last);
        let moments: Vec<_> = (0..4)
            .map(|i| {
                Rigid3::from_axis_angle(
                    Vector3::zeros(),
                    Vector3::new(-0.4 * f64::from(i), 0.0, 0.0),
                )
            })
            .collect();
        let rigs: Vec<_> = moments
            .iter()
            .zip(0..)
            .map(|(&pose, i)| problem.add_parameter(pose, EliminationOrder::At(i)))
            .collect();
        problem.fix(rigs[0]);
        problem.fix_dofs(rigs[3], &[3]).unwrap();
        for _ in 0..25 {
            let point = Vector3::new(
                4.0 * rng.uniform() - 1.4,
                3.0 * rng.uniform() - 1.5,
                3.0 + 3.0 * rng.uniform(),
            );
            let key = problem.add_landmark(point);
            for (rig_from_world, &rig) in moments.iter().zip(&rigs) {
                for (cam_from_rig, camera) in [(Rigid3::identity(), first), (cam_from_rig, second)]
                {
                    let in_cam = cam_from_rig * *rig_from_world * point;
                    let pixel = SimpleRadial::project(&true_params, &in_cam).unwrap();
                    let noise = Vector2::new(rng.normal(), rng.normal()) * NOISE_PX;
                    let factor = RigReprojection::<SimpleRadial>::new(pixel + noise, NOISE_PX);
                    problem.add((params, camera, rig, key), factor, Loss::Trivial).unwrap();
                }
            }
        }
        assert!(solve(&mut problem, LinearSolver::Auto, 20).termination.converged());
        let covariance = problem.covariance(&[second.into()]).unwrap().of(second).unwrap();
        let error = tiepoint_ba::Manifold::minus(&problem.get(second), &cam_from_rig);
        let error = DMatrix::from_column_slice(6, 1, error.as_slice());
        total += (error.transpose() * covariance.try_inverse().unwrap() * &error)[(0, 0)];
    }
    let mean = total / f64::from(RUNS);
    assert!((mean - 6.0).abs() < 4.0 * (12.0 / f64::from(RUNS)).sqrt(), "{mean}");
}
