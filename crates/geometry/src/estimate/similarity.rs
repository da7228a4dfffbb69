//! The similarity transform between two point sets with outliers.

use std::ops::Range;

use nalgebra::Vector3;

use crate::ransac::{Estimator, RansacOptions, Report, ransac};
use crate::{Loss, Sim3, solvers};

/// Estimates the similarity transform that maps `from[i]` to `to[i]`, with scale one unless
/// `with_scale`. `options.max_error` is a distance in the unit of `to`. `None` if no transform has
/// enough inliers.
pub fn similarity(
    from: &[Vector3<f64>],
    to: &[Vector3<f64>],
    with_scale: bool,
    options: &RansacOptions,
) -> Option<Report<Sim3>> {
    ransac(&Similarity { from, to, with_scale }, options)
}

/// The RANSAC problem of the similarity transform.
struct Similarity<'a> {
    from: &'a [Vector3<f64>],
    to: &'a [Vector3<f64>],
    with_scale: bool,
}

impl Similarity<'_> {
    /// The least-squares similarity of the data with these indices.
    fn fit(&self, indices: &[usize]) -> Option<Sim3> {
        let pick = |points: &[Vector3<f64>]| indices.iter().map(|&i| points[i]).collect::<Vec<_>>();
        solvers::umeyama(&pick(self.from), &pick(self.to), self.with_scale)
    }
}

impl Estimator for Similarity<'_> {
    type Model = Sim3;
    const SAMPLE_SIZE: usize = 3;

    fn num_data(&self) -> usize {
        self.from.len().min(self.to.len())
    }

    fn models(&self, sample: &[usize], models: &mut Vec<Sim3>) {
        models.extend(self.fit(sample));
    }

    fn squared_residuals(&self, model: &Sim3, range: Range<usize>, squared: &mut [f64]) {
        let points = self.from[range.clone()].iter().zip(&self.to[range]);
        for (squared, (from, to)) in squared.iter_mut().zip(points) {
            *squared = (*model * *from - to).norm_squared();
        }
    }

    fn refine(&self, model: &Sim3, data: &[usize], loss: Loss) -> Option<Sim3> {
        let has_weight = |i: &usize| {
            let squared = (*model * self.from[*i] - self.to[*i]).norm_squared();
            loss.evaluate(squared)[1] >= 0.5
        };
        self.fit(&data.iter().copied().filter(has_weight).collect::<Vec<_>>())
    }
}
