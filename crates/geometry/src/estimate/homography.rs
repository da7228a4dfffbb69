//! The homography between two images of a plane, or from one place.

use std::ops::Range;

use nalgebra::{Matrix3, SMatrix, SVector, Vector2};

use super::MAX_LM_ITERATIONS;
use crate::ransac::{Estimator, RansacOptions, Report, ransac};
use crate::small_lm::{Normal, Problem, minimize};
use crate::solvers::normalisation;
use crate::{Loss, solvers};

/// The homography, of norm 1, that takes `points1[i]` to `points2[i]`: four-point solver on samples, then least transfer error of
/// the inliers. Errors are distances in image 2.
pub fn homography(
    points1: &[Vector2<f64>],
    points2: &[Vector2<f64>],
    options: &RansacOptions,
) -> Option<Report<Matrix3<f64>>> {
    let count = points1.len().min(points2.len());
    let (to_unit1, to_unit2) = (normalisation(&points1[..count])?, normalisation(&points2[..count])?);
    let apply = |m: &Matrix3<f64>, points: &[Vector2<f64>]| -> Vec<Vector2<f64>> {
        points[..count].iter().map(|p| (m * p.push(1.0)).xy()).collect()
    };
    let estimator = Homography {
        points1: apply(&to_unit1, points1),
        points2: apply(&to_unit2, points2),
        px_per_unit: 1.0 / to_unit2.m11,
    };
    let px_from_unit2 = to_unit2.try_inverse()?;
    let report = ransac(&estimator, options)?;
    Some(report.map(|h| (px_from_unit2 * h * to_unit1).normalize()))
}

struct Homography {
    points1: Vec<Vector2<f64>>,
    points2: Vec<Vector2<f64>>,
    px_per_unit: f64,
}

impl Estimator for Homography {
    type Model = Matrix3<f64>;
    const SAMPLE_SIZE: usize = 4;

    fn num_data(&self) -> usize {
        self.points1.len()
    }

    fn models(&self, sample: &[usize], models: &mut Vec<Matrix3<f64>>) {
        let points1: [Vector2<f64>; 4] = std::array::from_fn(|i| self.points1[sample[i]]);
        let points2: [Vector2<f64>; 4] = std::array::from_fn(|i| self.points2[sample[i]]);
        models.extend(solvers::homography_4pt(&points1, &points2));
    }

    fn squared_residuals(&self, model: &Matrix3<f64>, range: Range<usize>, squared: &mut [f64]) {
        let points = self.points1[range.clone()].iter().zip(&self.points2[range]);
        for (squared, (x1, x2)) in squared.iter_mut().zip(points) {
            let y = model * x1.push(1.0);
            let error2 = ((y.xy() / y.z - x2) * self.px_per_unit).norm_squared();
            *squared = if y.z > 0.0 { error2 } else { f64::INFINITY };
        }
    }

    fn refine(&self, model: &Matrix3<f64>, data: &[usize], loss: Loss) -> Option<Matrix3<f64>> {
        // The corner is the depth at the centre of the points; it is zero only if the centre is on the horizon.
        let start = model / model.m33;
        if model.m33 <= 0.0 || !start.iter().all(|v| v.is_finite()) {
            return None;
        }
        Some(minimize(&Transfer { data: self, inliers: data }, &start, loss, MAX_LM_ITERATIONS))
    }
}

struct Transfer<'a> {
    data: &'a Homography,
    inliers: &'a [usize],
}

/// The entries row by row, without the corner, which stays one.
impl Problem<8> for Transfer<'_> {
    type Value = Matrix3<f64>;

    fn plus(&self, value: &Matrix3<f64>, delta: &SVector<f64, 8>) -> Matrix3<f64> {
        Matrix3::from_fn(|row, column| {
            value[(row, column)] + delta.get(3 * row + column).copied().unwrap_or(0.0)
        })
    }

    fn linearize(&self, value: &Matrix3<f64>, normal: &mut Normal<8>) {
        for &i in self.inliers {
            let [x, y] = self.data.points1[i].into();
            let image = value * self.data.points1[i].push(1.0);
            if image.z <= 0.0 {
                normal.refuse();
                continue;
            }
            let (w, px_per_unit) = (1.0 / image.z, self.data.px_per_unit);
            let [u, v] = [image.x * w, image.y * w];
            #[rustfmt::skip]
            let jacobian = SMatrix::<f64, 2, 8>::from_row_slice(&[
                x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y,
                0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y,
            ]) * (w * px_per_unit);
            normal.add(&((Vector2::new(u, v) - self.data.points2[i]) * px_per_unit), &jacobian);
        }
    }
}
