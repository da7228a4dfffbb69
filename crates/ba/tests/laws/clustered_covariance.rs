//! Cluster-robust covariances, compared with dense matrices, and with the scatter of estimates
//! under correlated noise.

use std::hash::{DefaultHasher, Hash, Hasher};

use proptest::prelude::*;
use tiepoint_ba::autodiff::{AutoDiff, Residual, Scalar};
use tiepoint_ba::factors::Prior;
use tiepoint_ba::nalgebra::{DMatrix, DVector, Vector1, Vector2, Vector3};
use tiepoint_ba::{
    AnyKey, ClusteredCovariance, Covariance, EliminationOrder, FactorKey, Key, LinearSolver, Loss,
    Problem,
};
use tiepoint_geometry::Rng;

use crate::scene::{Intrinsics, NOISE_PX, Scene, solve};

/// Two measurements, linear in a parameter that all share, another one, and a landmark.
#[derive(Clone, Copy)]
struct Sample {
    shared: [[f64; 3]; 2],
    own: [[f64; 2]; 2],
    landmark: [[f64; 3]; 2],
    measured: [f64; 2],
}

impl Residual<2> for Sample {
    type Vars = (Vector3<f64>, Vector2<f64>, Vector3<f64>);
    fn residual<T: Scalar>(&self, (a, b, p): ([T; 3], [T; 2], [T; 3])) -> Option<[T; 2]> {
        Some(std::array::from_fn(|r| {
            let ([a0, a1, a2], [b0, b1]) = (self.shared[r], self.own[r]);
            let [p0, p1, p2] = self.landmark[r];
            a[0] * a0
                + a[1] * a1
                + a[2] * a2
                + b[0] * b0
                + b[1] * b1
                + p[0] * p0
                + p[1] * p1
                + p[2] * p2
                - self.measured[r]
        }))
    }
}

const LOSS: Loss = Loss::Cauchy(1.5);
const NUM_OWN: usize = 4;
const NUM_LANDMARKS: usize = 30;
const NUM_CLUSTERS: u32 = 7;
const PRIOR_SIGMA: f64 = 0.7;

/// A problem at arbitrary values with its dense weighted Jacobian and residual: the shared
/// parameter, the others, the landmarks. Two directions are fixed.
struct Dense {
    problem: Problem,
    keys: Vec<AnyKey>,
    /// Cluster of each factor.
    clusters: Vec<(FactorKey, u32)>,
    /// Rows of the Jacobian, residuals, and the landmark and the cluster of each.
    rows: Vec<(DVector<f64>, f64, Option<[u32; 2]>)>,
}

impl Dense {
    fn new(seed: u64) -> Self {
        let mut rng = Rng::stream(seed, &[50]);
        let mut problem = Problem::new();
        let columns = 3 + 2 * NUM_OWN + 3 * NUM_LANDMARKS;
        let values = DVector::from_fn(columns, |_, _| rng.normal());
        let shared = problem
            .add_parameter(Vector3::new(values[0], values[1], values[2]), EliminationOrder::Last);
        let own: Vec<Key<Vector2<f64>>> = (0..NUM_OWN)
            .map(|i| {
                let value = Vector2::new(values[3 + 2 * i], values[4 + 2 * i]);
                problem.add_parameter(value, EliminationOrder::At(i as u32))
            })
            .collect();
        let mut keys: Vec<AnyKey> = vec![shared.into()];
        keys.extend(own.iter().map(|&key| AnyKey::from(key)));
        let (mut clusters, mut rows) = (Vec::new(), Vec::new());
        for landmark in 0..NUM_LANDMARKS {
            let first = 3 + 2 * NUM_OWN + 3 * landmark;
            let value = Vector3::new(values[first], values[first + 1], values[first + 2]);
            let key = problem.add_landmark(value);
            keys.push(key.into());
            if landmark == 0 {
                problem.fix_dofs(key, &[1]).unwrap();
            }
            for (i, &own) in own.iter().enumerate() {
                if rng.uniform() < 0.1 {
                    continue;
                }
                let mut number = || rng.normal();
                let sample = Sample {
                    shared: std::array::from_fn(|_| std::array::from_fn(|_| number())),
                    own: std::array::from_fn(|_| std::array::from_fn(|_| number())),
                    landmark: std::array::from_fn(|_| std::array::from_fn(|_| number())),
                    measured: std::array::from_fn(|_| number()),
                };
                let jacobian = |r: usize| {
                    let mut row = DVector::zeros(columns);
                    row.rows_mut(0, 3).copy_from_slice(&sample.shared[r]);
                    row.rows_mut(3 + 2 * i, 2).copy_from_slice(&sample.own[r]);
                    row.rows_mut(first, 3).copy_from_slice(&sample.landmark[r]);
                    row
                };
                let jacobians = [jacobian(0), jacobian(1)];
                let residual = [0, 1].map(|r| jacobians[r].dot(&values) - sample.measured[r]);
                let squared = residual.iter().map(|r| r * r).sum();
                let weight = LOSS.evaluate(squared)[1].sqrt();
                let of = [landmark as u32, rng.below(NUM_CLUSTERS as usize) as u32];
                let factor = problem.add((shared, own, key), AutoDiff(sample), LOSS).unwrap();
                clusters.push((factor, of[1]));
                rows.extend(
                    (jacobians.into_iter().zip(residual))
                        .map(|(j, r)| (j * weight, r * weight, Some(of))),
                );
            }
        }
        // Priors are in no cluster. Some landmarks have too few measurements without one.
        for (&key, first) in keys[1 + NUM_OWN..].iter().zip((3 + 2 * NUM_OWN..).step_by(3)) {
            let prior = Prior::new(Vector3::zeros(), &[PRIOR_SIGMA; 3]).unwrap();
            let key = key.typed::<Vector3<f64>>().unwrap();
            problem.add(key, prior, Loss::Trivial).unwrap();
            rows.extend((0..3).map(|k| {
                let mut row = DVector::zeros(columns);
                row[first + k] = 1.0 / PRIOR_SIGMA;
                (row, 0.0, None)
            }));
        }
        problem.fix_dofs(shared, &[2]).unwrap();
        let fixed = [2, 3 + 2 * NUM_OWN + 1];
        rows.iter_mut().for_each(|(row, ..)| fixed.iter().for_each(|&at| row[at] = 0.0));
        Self { problem, keys, clusters, rows }
    }

    fn found(&self) -> ClusteredCovariance {
        self.problem
            .clustered_covariance(&self.keys, |factor| find(&self.clusters, factor))
            .unwrap()
    }

    /// H⁻¹ of the free directions, with zeros in the fixed ones.
    fn inverse(&self) -> DMatrix<f64> {
        let columns = self.rows[0].0.len();
        let mut h = DMatrix::zeros(columns, columns);
        self.rows.iter().for_each(|(row, ..)| h += row * row.transpose());
        let fixed: Vec<usize> = (0..columns).filter(|&i| h[(i, i)] == 0.0).collect();
        fixed.iter().for_each(|&i| h[(i, i)] = 1.0);
        let mut inverse = h.try_inverse().unwrap();
        fixed.iter().for_each(|&i| inverse[(i, i)] = 0.0);
        inverse
    }

    /// Σ Jᵀr of the rows of a landmark for which `is_in` holds, with the residuals for the landmark
    /// that the other rows give.
    fn score(&self, landmark: u32, is_in: impl Fn([u32; 2]) -> bool) -> Option<DVector<f64>> {
        let first = 3 + 2 * NUM_OWN + 3 * landmark as usize;
        let of = |row: &DVector<f64>| row.rows(first, 3).into_owned();
        let mut v = DMatrix::zeros(3, 3);
        self.rows.iter().for_each(|(row, ..)| v += of(row) * of(row).transpose());
        (0..3)
            .filter(|&k| v[(k, k)] == 0.0)
            .collect::<Vec<_>>()
            .iter()
            .for_each(|&k| v[(k, k)] = 1.0);
        let these: Vec<_> = (self.rows.iter())
            .filter(|(.., clusters)| clusters.is_some_and(|of| of[0] == landmark && is_in(of)))
            .collect();
        if these.is_empty() {
            return None;
        }
        let j_p = DMatrix::from_fn(these.len(), 3, |i, k| these[i].0[first + k]);
        let residuals = DVector::from_fn(these.len(), |i, _| these[i].1);
        let leverage = &j_p * v.try_inverse().unwrap() * j_p.transpose();
        let identity = DMatrix::identity(these.len(), these.len());
        let residuals = (identity - leverage).try_inverse().unwrap() * residuals;
        these.iter().zip(&residuals).map(|((row, ..), r)| row * *r).reduce(|a, b| a + b)
    }

    /// H⁻¹ Σ g gᵀ H⁻¹ C/(C − 1).
    fn sandwich(&self, scores: &[DVector<f64>]) -> DMatrix<f64> {
        let (inverse, count) = (self.inverse(), scores.len() as f64);
        let middle = scores.iter().map(|g| g * g.transpose()).reduce(|a, b| a + b).unwrap();
        &inverse * middle * &inverse * (count / (count - 1.0))
    }

    /// By landmark, by cluster, by both, and of independent factors.
    fn expected(&self) -> [DMatrix<f64>; 4] {
        let landmarks = || 0..NUM_LANDMARKS as u32;
        let score = |landmark, cluster| self.score(landmark, |of| of[1] == cluster);
        let by_landmark: Vec<_> = landmarks().filter_map(|l| self.score(l, |_| true)).collect();
        let by_cluster: Vec<_> = (0..NUM_CLUSTERS)
            .filter_map(|c| landmarks().filter_map(|l| score(l, c)).reduce(|a, b| a + b))
            .collect();
        let by_both: Vec<_> =
            landmarks().flat_map(|l| (0..NUM_CLUSTERS).filter_map(move |c| score(l, c))).collect();
        let inverse = self.inverse();
        let others = self.rows.iter().filter(|(.., clusters)| clusters.is_none());
        let middle = others.map(|(row, ..)| row * row.transpose()).reduce(|a, b| a + b).unwrap();
        let independent = &inverse * middle * &inverse;
        let [by_landmark, by_cluster, by_both] =
            [by_landmark, by_cluster, by_both].map(|scores| self.sandwich(&scores));
        [by_landmark, by_cluster, by_both, independent]
    }
}

fn find(clusters: &[(FactorKey, u32)], factor: FactorKey) -> Option<u32> {
    Some(clusters[clusters.binary_search_by_key(&factor, |(key, _)| *key).ok()?].1)
}

/// Rounding of double precision times the condition number of these problems, and of the single
/// precision that landmarks are stored in.
const SAME: f64 = 1e-8;
const SAME_LANDMARKS: f64 = 1e-5;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn it_is_that_of_dense_matrices(seed in 0..u64::MAX) {
        let dense = Dense::new(seed);
        let found = dense.found();
        let kept = 3 + 2 * NUM_OWN;
        let ClusteredCovariance { by_landmark, by_cluster, by_both, independent } = found;
        let found = [by_landmark, by_cluster, by_both, independent];
        for (found, expected) in found.iter().map(Covariance::matrix).zip(dense.expected()) {
            let difference = found - &expected;
            let of_kept = |matrix: &DMatrix<f64>| matrix.view((0, 0), (kept, kept)).amax();
            prop_assert!(of_kept(&difference) <= SAME * of_kept(&expected), "{difference}");
            prop_assert!(difference.amax() <= SAME_LANDMARKS * expected.amax(), "{difference}");
        }
    }
}

/// A measurement of a track's landmark plus a number times a common parameter.
struct OfTrack {
    common: f64,
    measured: f64,
}

impl Residual<1> for OfTrack {
    type Vars = (Vector1<f64>, Vector1<f64>);
    fn residual<T: Scalar>(&self, ([x], [p]): ([T; 1], [T; 1])) -> Option<[T; 1]> {
        Some([x * self.common + p - self.measured])
    }
}

const TRACKS: usize = 60;
const TRACK_LENGTH: usize = 6;
const CELLS: usize = 40;
const DRAWS: u64 = 200;
/// The variance of this many draws has a relative standard deviation of √(2 / (draws − 1)) = 0.1.
/// Four of them, and 1/20 for the parameters per cluster.
const TOLERANCE: f64 = 0.45;

/// Stated variances of the common parameter: by track, by track and cell, and of independent
/// residuals, averaged over the draws; and the variance of the estimates.
fn stated_and_empirical(of_track: f64, of_cell: f64) -> ([f64; 3], f64) {
    let (mut stated, mut empirical) = ([0.0; 3], 0.0);
    for draw in 0..DRAWS {
        // The same measurements in each draw, with other noise.
        let (mut design, mut noise) = (Rng::stream(1, &[51]), Rng::stream(draw, &[52]));
        let mut normal = || noise.normal();
        let cells: Vec<f64> = (0..CELLS).map(|_| of_cell * normal()).collect();
        let mut problem = Problem::new();
        let common = problem.add_parameter(Vector1::zeros(), EliminationOrder::Last);
        let mut clusters = Vec::new();
        for _ in 0..TRACKS {
            let landmark = problem.add_landmark(Vector1::zeros());
            let bend = of_track * normal();
            for i in 0..TRACK_LENGTH {
                let cell = design.below(CELLS);
                let error = bend * (i as f64 - 2.0) + cells[cell] + normal();
                // The errors of a cell do not average out over the tracks.
                let common_factor = 4.0 * cell as f64 / CELLS as f64 + 0.5 * i as f64;
                let factor = OfTrack { common: common_factor, measured: error };
                let added =
                    problem.add((common, landmark), AutoDiff(factor), Loss::Trivial).unwrap();
                clusters.push((added, cell as u32));
            }
        }
        assert!(solve(&mut problem, LinearSolver::Auto, 10).termination.converged());
        let keys = [common.into()];
        let found = problem.clustered_covariance(&keys, |key| find(&clusters, key)).unwrap();
        let variance = |of: &Covariance| of.matrix()[(0, 0)];
        let [by_landmark, by_cluster, by_both] =
            [&found.by_landmark, &found.by_cluster, &found.by_both].map(variance);
        let by_two_ways = by_landmark + by_cluster - by_both;
        let independent = variance(&problem.covariance(&keys).unwrap());
        for (sum, variance) in stated.iter_mut().zip([by_landmark, by_two_ways, independent]) {
            *sum += variance / DRAWS as f64;
        }
        empirical += problem.get(common).x.powi(2) / DRAWS as f64;
    }
    (stated, empirical)
}

#[test]
fn it_is_the_scatter_of_estimates_under_correlated_noise() {
    for (of_track, of_cell) in [(0.0, 0.0), (1.0, 0.0), (0.0, 2.0), (1.0, 2.0)] {
        let (stated, empirical) = stated_and_empirical(of_track, of_cell);
        let [by_track, by_both, independent] = stated.map(|variance| variance / empirical);
        eprintln!(
            "noise of tracks {of_track}, of cells {of_cell}: variance {empirical:.5}, stated by \
            track {by_track:.2}, by track and cell {by_both:.2}, as independent {independent:.2}"
        );
        assert!((by_both - 1.0).abs() < TOLERANCE, "{by_both}");
        if of_track + of_cell == 0.0 {
            assert!((independent - 1.0).abs() < TOLERANCE, "{independent}");
        } else {
            assert!(independent < 1.0 - TOLERANCE, "{independent}");
        }
    }
}

/// Some thousand factors are several tasks.
#[test]
fn it_is_the_same_at_any_number_of_threads() {
    let found = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut scene = Scene::new(12, 2000, 0.5, 5, Intrinsics::Shared, NOISE_PX);
        scene.fix_gauge();
        pool.install(|| {
            let keys = [scene.intrinsics[0].into()];
            scene.problem.clustered_covariance(&keys, number_of).unwrap()
        })
    };
    assert_eq!(found(1), found(3));
}

/// One of 50 clusters.
fn number_of(factor: FactorKey) -> Option<u32> {
    let mut hasher = DefaultHasher::new();
    factor.hash(&mut hasher);
    Some((hasher.finish() % 50) as u32)
}

#[test]
fn one_cluster_tells_nothing_and_none_is_independent() {
    let dense = Dense::new(1);
    let keys = &dense.keys[..3];
    let one = dense.problem.clustered_covariance(keys, |_| Some(0)).unwrap();
    assert_eq!(one.by_cluster.matrix().amax(), 0.0);
    assert_eq!(one.by_both, one.by_landmark);
    let none = dense.problem.clustered_covariance(keys, |_| None).unwrap();
    assert_eq!(none.by_landmark.matrix().amax(), 0.0);
    let expected = dense.problem.covariance(keys).unwrap();
    let difference = (none.independent.matrix() - expected.matrix()).amax();
    assert!(difference <= SAME * expected.matrix().amax(), "{difference}");
}
