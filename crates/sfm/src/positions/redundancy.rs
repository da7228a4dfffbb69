//! What the residuals of measured points tell about errors of single points.
//!
//! Of measured coordinates ℓ with covariance Σ and adjusted ones x̂ with covariance C, the
//! residuals v = x̂ − ℓ have the covariance Σ − C. In deviations of the coordinates that is
//! R = I − Σ^-½ C Σ^-½, the redundancy matrix: a point whose coordinates are off by b deviations
//! has residuals of −R b, and R is also the information of b. So freeing the coordinates of a point
//! lowers the sum of squares by T = vᵀ R⁻¹ v of its block, which is χ² with three degrees of
//! freedom if the point is right (data snooping: Baarda 1968; Teunissen 2006, Testing theory,
//! chapter 4). An error is detectable if T exceeds its quantile in four of five cases, which takes
//! a non-centrality bᵀ R b = λ₀.
//!
//! An error of one point also moves the residuals of others, so that T of a right point may exceed
//! the quantile. A point is wrong only if it contradicts the others whichever other point is freed
//! as well: if another one alone is wrong, that names a right point in one of a thousand cases.

use tiepoint_geometry::nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Least share of an error that its residual shows. Below it errors of 300 deviations are below one
/// deviation of the residual, and an adjustment that has not quite converged tells as much.
const MIN_REDUNDANCY: f64 = 1e-5;
/// The 99.9 % quantiles of χ² with no, one, two and three degrees of freedom.
const QUANTILES: [f64; 4] = [f64::INFINITY, 10.828, 13.816, 16.266];
/// Non-centralities λ₀ with which χ² exceeds these quantiles in 80 % of cases (scipy.stats.ncx2).
const NON_CENTRALITIES: [f64; 4] = [f64::INFINITY, 17.075, 19.662, 21.545];

/// The residuals of some measured points in deviations of their coordinates, and their covariance.
pub(super) struct Redundancy {
    residuals: DVector<f64>,
    matrix: DMatrix<f64>,
    /// Of each point, in metres.
    sigmas: Vec<Vector3<f64>>,
}

/// What the residuals tell about a point.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Verdict {
    /// Whether it is left out, and no other point explains that.
    pub(super) is_wrong: bool,
    /// If it is left out, the points that may be wrong in its place.
    pub(super) alternatives: Vec<usize>,
    /// Sizes of errors along the axes that are detected in 80 % of cases, in metres.
    pub(super) detectable_m: Vector3<f64>,
    /// Sizes of errors along the axes that no other point explains, in 80 % of cases, in metres.
    pub(super) separable_m: Vector3<f64>,
}

/// Residuals and information of a point or of all, given that the coordinates of others are free.
struct Block {
    residuals: DVector<f64>,
    matrix: DMatrix<f64>,
}

impl Block {
    /// The sum of squares that freeing its coordinates saves, and the number of tested directions.
    fn saved(self) -> (f64, usize) {
        let eigen = self.matrix.symmetric_eigen();
        let along = eigen.eigenvectors.tr_mul(&self.residuals);
        let tested = eigen.eigenvalues.iter().zip(along.iter());
        tested
            .filter(|(value, _)| **value > MIN_REDUNDANCY)
            .fold((0.0, 0), |sum, (value, along)| (sum.0 + along * along / value, sum.1 + 1))
    }
}

impl Redundancy {
    /// Of places that were adjusted together with the measured coordinates of those that are
    /// `used`; those of the others are predictions. `errors` are the places minus the measured
    /// coordinates, `covariance` the joint one of the places, in metres.
    pub(super) fn new(
        errors: &[Vector3<f64>],
        sigmas: &[Vector3<f64>],
        covariance: &DMatrix<f64>,
        used: &[bool],
    ) -> Self {
        let size = 3 * errors.len();
        let sigma = |i: usize| sigmas[i / 3][i % 3];
        let mut residuals = DVector::from_fn(size, |i, _| errors[i / 3][i % 3] / sigma(i));
        let mut of_places = DMatrix::from_fn(size, size, |row, column| {
            covariance[(row, column)] / (sigma(row) * sigma(column))
        });
        // An update with the coordinates that were not used (Kalman 1960) makes all used.
        let unused: Vec<usize> = (0..size).filter(|i| !used[i / 3]).collect();
        if !unused.is_empty() {
            let columns = of_places.select_columns(&unused);
            let predicted =
                DMatrix::identity(unused.len(), unused.len()) + columns.select_rows(&unused);
            if let Some(cholesky) = predicted.cholesky() {
                residuals -= &columns * cholesky.solve(&residuals.select_rows(&unused));
                of_places -= &columns * cholesky.solve(&columns.transpose());
            }
        }
        Self {
            residuals,
            matrix: DMatrix::identity(size, size) - of_places,
            sigmas: sigmas.to_vec(),
        }
    }

    /// Of a least-squares fit to measured coordinates, with `residuals` and `jacobian` in
    /// deviations of the coordinates, where it is linearised: C is J (JᵀJ)⁻¹ Jᵀ = QQᵀ, of the QR
    /// decomposition.
    pub(super) fn of_fit(
        residuals: &DVector<f64>,
        jacobian: DMatrix<f64>,
        sigmas: Vec<Vector3<f64>>,
    ) -> Self {
        let q = jacobian.qr().q();
        let residuals = residuals - &q * q.tr_mul(residuals);
        Self {
            residuals,
            matrix: DMatrix::identity(q.nrows(), q.nrows()) - &q * q.transpose(),
            sigmas,
        }
    }

    fn num_points(&self) -> usize {
        self.sigmas.len()
    }

    /// The block of some points, given that the coordinates of `freed` are free.
    fn block(&self, points: &[usize], freed: &[usize]) -> Block {
        let indices = |points: &[usize]| -> Vec<usize> {
            points.iter().flat_map(|point| 3 * point..3 * point + 3).collect()
        };
        let (own, freed) = (indices(points), indices(freed));
        let mut block = Block {
            residuals: self.residuals.select_rows(&own),
            matrix: self.matrix.select_rows(&own).select_columns(&own),
        };
        if freed.is_empty() {
            return block;
        }
        let eigen = self.matrix.select_rows(&freed).select_columns(&freed).symmetric_eigen();
        let across = self.matrix.select_rows(&own).select_columns(&freed) * &eigen.eigenvectors;
        let along = eigen.eigenvectors.tr_mul(&self.residuals.select_rows(&freed));
        for (k, value) in eigen.eigenvalues.iter().enumerate() {
            if *value > MIN_REDUNDANCY {
                block.residuals -= across.column(k) * (along[k] / value);
                block.matrix -= across.column(k) * across.column(k).transpose() / *value;
            }
        }
        block
    }

    /// What freeing a point saves, given that `freed` are free, and whether that is more than
    /// chance explains for this variance factor.
    fn test(&self, point: usize, freed: &[usize], factor: f64) -> (f64, bool) {
        let (saved, tested) = self.block(&[point], freed).saved();
        (saved, saved > QUANTILES[tested] * factor)
    }

    /// The mean square of the residuals that are left with these points free, for each direction
    /// that is tested; at least 1.
    fn variance_factor(&self, freed: &[usize]) -> f64 {
        let others: Vec<usize> = self.without(freed).collect();
        let (left, tested) = self.block(&others, freed).saved();
        (left / tested.max(1) as f64).max(1.0)
    }

    fn without(&self, points: &[usize]) -> impl Iterator<Item = usize> + use<'_> {
        let points = points.to_vec();
        (0..self.num_points()).filter(move |k| !points.contains(k))
    }

    /// The points to leave out, beginning with some, so that at least `min_used` are left. A point
    /// is taken in if it does not contradict the others, and left out if it does: also beyond the
    /// residuals of the others without it, since a model whose errors are larger than its keypoints
    /// say contradicts all points. Last, points are exchanged while that leaves smaller residuals.
    pub(super) fn left_out(&self, first: &[usize], min_used: usize) -> Vec<usize> {
        let mut left_out = first.to_vec();
        // Each round lowers the residuals or the number of points that are left out.
        for _ in 0..2 * self.num_points() {
            if let Some(next) = self.with_one_more_used(&left_out) {
                left_out = next;
            } else if let Some(next) = self.with_one_less_used(&left_out, min_used) {
                left_out = next;
            } else {
                break;
            }
        }
        left_out = self.exchanged(left_out);
        left_out.sort_unstable();
        left_out
    }

    fn with_one_more_used(&self, left_out: &[usize]) -> Option<Vec<usize>> {
        let factor = self.variance_factor(left_out);
        let tests = left_out.iter().map(|&point| {
            let others = except(left_out, point);
            (self.test(point, &others, factor), others)
        });
        let fitting = tests.filter(|((_, contradicts), _)| !contradicts);
        Some(fitting.min_by(|a, b| a.0.0.total_cmp(&b.0.0))?.1)
    }

    fn with_one_less_used(&self, left_out: &[usize], min_used: usize) -> Option<Vec<usize>> {
        if left_out.len() + min_used >= self.num_points() {
            return None;
        }
        let tests = self.without(left_out).map(|point| (self.test(point, left_out, 1.0), point));
        let ((_, contradicts), worst) = tests.max_by(|a, b| a.0.0.total_cmp(&b.0.0))?;
        let with_worst: Vec<usize> = left_out.iter().copied().chain([worst]).collect();
        let factor = self.variance_factor(&with_worst);
        (contradicts && self.test(worst, left_out, factor).1).then_some(with_worst)
    }

    /// The points with which those that are left out are exchanged one by one.
    fn exchanged(&self, mut left_out: Vec<usize>) -> Vec<usize> {
        for _ in 0..self.num_points() {
            let better = left_out.iter().find_map(|&point| {
                let others = except(&left_out, point);
                let saved = |k: usize| self.block(&[k], &others).saved().0;
                let best =
                    self.without(&left_out).max_by(|a, b| saved(*a).total_cmp(&saved(*b)))?;
                (saved(best) > saved(point)).then(|| others.iter().copied().chain([best]).collect())
            });
            match better {
                Some(better) => left_out = better,
                None => break,
            }
        }
        left_out
    }

    /// What the residuals tell about each point, given those that are left out.
    pub(super) fn verdicts(&self, left_out: &[usize]) -> Vec<Verdict> {
        let factor = self.variance_factor(left_out);
        let verdict = |point: usize| {
            let others = except(left_out, point);
            let with =
                |rival: usize| -> Vec<usize> { others.iter().copied().chain([rival]).collect() };
            let rivals: Vec<usize> = self.without(left_out).filter(|k| *k != point).collect();
            let is_left_out = left_out.contains(&point);
            let explains = |rival: &&usize| !self.test(point, &with(**rival), factor).1;
            let alternatives: Vec<usize> = match is_left_out {
                true => rivals.iter().filter(explains).copied().collect(),
                false => Vec::new(),
            };
            let detectable = |freed: &[usize]| self.detectable_m(point, freed, factor);
            let separable_m = rivals.iter().map(|rival| detectable(&with(*rival)));
            Verdict {
                is_wrong: is_left_out && alternatives.is_empty(),
                alternatives,
                detectable_m: detectable(&others),
                separable_m: separable_m.fold(Vector3::zeros(), |a, b| a.sup(&b)),
            }
        };
        (0..self.num_points()).map(verdict).collect()
    }

    fn detectable_m(&self, point: usize, freed: &[usize], factor: f64) -> Vector3<f64> {
        let matrix = self.block(&[point], freed).matrix;
        let matrix = Matrix3::from_fn(|row, column| matrix[(row, column)]);
        let tested =
            matrix.symmetric_eigenvalues().iter().filter(|it| **it > MIN_REDUNDANCY).count();
        self.sigmas[point].zip_map(&matrix.diagonal(), |sigma_m, redundancy| {
            sigma_m * (factor * NON_CENTRALITIES[tested] / redundancy.max(0.0)).sqrt()
        })
    }
}

fn except(points: &[usize], point: usize) -> Vec<usize> {
    points.iter().copied().filter(|k| *k != point).collect()
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::Rng;

    use super::*;

    /// Deviations of the survey, and of places by marks, in metres.
    const SURVEY_M: f64 = 0.01;
    const MARKS_M: f64 = 0.05;

    /// Points of a survey with marks in a model whose seven parameters are free: y = x + J t.
    struct Survey {
        /// By the parameters (x, t): the rows are marks, then coordinates, in deviations.
        jacobian: DMatrix<f64>,
        values: DVector<f64>,
        num_points: usize,
    }

    impl Survey {
        fn new(num_points: usize, rng: &mut Rng) -> Self {
            let size = 3 * num_points;
            let mut jacobian = DMatrix::zeros(2 * size, size + 7);
            let mut values = DVector::zeros(2 * size);
            for k in 0..num_points {
                let place = Vector3::from_fn(|axis, _| [20.0, 20.0, 3.0][axis] * rng.normal());
                let turns = -place.cross_matrix();
                for axis in 0..3 {
                    let (mark, coordinate) = (3 * k + axis, size + 3 * k + axis);
                    jacobian[(mark, mark)] = 1.0 / MARKS_M;
                    jacobian[(mark, size + axis)] = 1.0 / MARKS_M;
                    for about in 0..3 {
                        jacobian[(mark, size + 3 + about)] = turns[(axis, about)] / MARKS_M;
                    }
                    jacobian[(mark, size + 6)] = place[axis] / MARKS_M;
                    jacobian[(coordinate, mark)] = 1.0 / SURVEY_M;
                    values[mark] = place[axis] / MARKS_M + rng.normal();
                    values[coordinate] = place[axis] / SURVEY_M + rng.normal();
                }
            }
            Self { jacobian, values, num_points }
        }

        /// An error of the coordinates of a point.
        fn add(&mut self, point: usize, error_m: Vector3<f64>) {
            for axis in 0..3 {
                self.values[3 * (self.num_points + point) + axis] += error_m[axis] / SURVEY_M;
            }
        }

        fn rows(&self, freed: &[usize]) -> Vec<usize> {
            let size = 3 * self.num_points;
            let is_free = |row: &usize| *row >= size && freed.contains(&((row - size) / 3));
            (0..2 * size).filter(|row| !is_free(row)).collect()
        }

        /// Places and their covariance without the coordinates of some points.
        fn solved(&self, freed: &[usize]) -> (DVector<f64>, DMatrix<f64>) {
            let rows = self.rows(freed);
            let (jacobian, values) =
                (self.jacobian.select_rows(&rows), self.values.select_rows(&rows));
            let covariance = jacobian.tr_mul(&jacobian).try_inverse().unwrap();
            let found = &covariance * jacobian.tr_mul(&values);
            (found, covariance)
        }

        /// The sum of squares without the coordinates of some points, which may leave parameters
        /// undetermined.
        fn cost(&self, freed: &[usize]) -> f64 {
            let rows = self.rows(freed);
            let (jacobian, values) =
                (self.jacobian.select_rows(&rows), self.values.select_rows(&rows));
            let found = jacobian.clone().svd(true, true).solve(&values, SINGULAR).unwrap();
            (jacobian * found - values).norm_squared()
        }

        fn redundancy(&self, freed: &[usize]) -> Redundancy {
            let (found, covariance) = self.solved(freed);
            let size = 3 * self.num_points;
            let error = |i: usize| found[i] - self.values[size + i] * SURVEY_M;
            let errors: Vec<Vector3<f64>> = (0..self.num_points)
                .map(|k| Vector3::from_fn(|axis, _| error(3 * k + axis)))
                .collect();
            let used: Vec<bool> = (0..self.num_points).map(|k| !freed.contains(&k)).collect();
            let sigmas = vec![Vector3::repeat(SURVEY_M); self.num_points];
            Redundancy::new(&errors, &sigmas, &covariance.view((0, 0), (size, size)).into(), &used)
        }

        fn verdicts(&self) -> Vec<Verdict> {
            let redundancy = self.redundancy(&[]);
            redundancy.verdicts(&redundancy.left_out(&[], 3))
        }
    }

    const SEED: u64 = 49;
    /// A singular value that is 0, where the others are 1 to 1e4.
    const SINGULAR: f64 = 1e-6;
    /// Relative error of differences of sums of squares near 1 with information of 1e4.
    const MAX_ERROR: f64 = 1e-6;

    /// The slow twin: least squares without the coordinates of a point.
    #[test]
    fn what_freeing_a_point_saves_is_what_least_squares_without_it_save() {
        let mut rng = Rng::stream(SEED, &[1]);
        for _ in 0..20 {
            let survey = Survey::new(5, &mut rng);
            let cost = |freed: &[usize]| survey.cost(freed);
            for predicted in [vec![], vec![1], vec![1, 4]] {
                let redundancy = survey.redundancy(&predicted);
                for freed in [vec![], vec![0], vec![1], vec![1, 3]] {
                    for point in redundancy.without(&freed) {
                        let with: Vec<usize> = freed.iter().copied().chain([point]).collect();
                        let expected = cost(&freed) - cost(&with);
                        let (saved, tested) = redundancy.block(&[point], &freed).saved();
                        let error = (saved - expected).abs();
                        assert!(error < MAX_ERROR * expected.max(1.0), "{saved} {expected}");
                        // Two points of five are left: six coordinates for seven parameters, so
                        // that the sum of squares is 0, and three of the others tell of two.
                        assert_eq!(tested, if with.len() == 3 { 2 } else { 3 });
                    }
                }
            }
        }
    }

    /// An error of the stated size is detected in four of five cases: of 400, 80 % have a standard
    /// deviation of 2 %.
    #[test]
    fn errors_of_the_detectable_size_are_detected() {
        let mut rng = Rng::stream(SEED, &[2]);
        let (mut detected, mut cases) = (0, 0);
        while cases < 400 {
            let mut survey = Survey::new(5, &mut rng);
            let size_m = survey.redundancy(&[]).verdicts(&[])[2].detectable_m;
            let axis = cases % 3;
            survey.add(2, Vector3::from_fn(|k, _| if k == axis { size_m[axis] } else { 0.0 }));
            detected += usize::from(survey.redundancy(&[]).test(2, &[], 1.0).1);
            cases += 1;
        }
        let share = detected as f64 / cases as f64;
        assert!((share - 0.8).abs() < 3.0 * 0.02, "{share}");
    }

    /// One of four or six points is wrong by up to 1 m. A right one is named in one of a thousand
    /// cases if one of the others is wrong, and so in five of a thousand at most.
    #[test]
    fn right_points_are_not_named() {
        let mut rng = Rng::stream(SEED, &[3]);
        for (num_points, min_named) in [(4, 0.2), (6, 0.5)] {
            let (mut right, mut wrong, cases) = (0, 0, 400);
            for case in 0..cases {
                let mut survey = Survey::new(num_points, &mut rng);
                let size_m = rng.uniform();
                let direction = Vector3::from_fn(|_, _| rng.normal()).normalize();
                survey.add(case % num_points, size_m * direction);
                let verdicts = survey.verdicts();
                for (k, verdict) in verdicts.iter().enumerate() {
                    let count = if k == case % num_points { &mut wrong } else { &mut right };
                    *count += usize::from(verdict.is_wrong);
                    assert!(verdict.alternatives.is_empty() || !verdict.is_wrong);
                }
            }
            let named = wrong as f64 / cases as f64;
            assert!(right <= 5 && named > min_named, "{num_points}: {right} {named}");
        }
    }
}
