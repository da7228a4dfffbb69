//! The fundamental matrix of two uncalibrated images.

use std::ops::Range;

use nalgebra::{Matrix3, Rotation3, SVector, UnitQuaternion, Vector2, Vector3};

use super::sampson::{Correspondence, CorrespondenceSubset, Correspondences};
use crate::ransac::{Estimator, RansacOptions, Report, ransac};
use crate::small_lm::{MAX_LM_ITERATIONS, NormalEquations, Problem, minimize};
use crate::solvers::normalisation;
use crate::{Loss, so3, solvers};

/// Estimates the fundamental matrix F with x₂ᵀ F x₁ = 0, of Frobenius norm 1, from corresponding
/// pixels. `None` if no model has enough inliers.
///
/// Minimal models come from the seven-point solver; refinement minimises the Sampson error.
/// `options.max_error` is a Sampson error in pixels.
pub fn fundamental(
    points1: &[Vector2<f64>],
    points2: &[Vector2<f64>],
    options: &RansacOptions,
) -> Option<Report<Matrix3<f64>>> {
    let count = points1.len().min(points2.len());
    let (points1, points2) = (&points1[..count], &points2[..count]);
    // Each image has its own centre, but both have one scale, so that the Sampson error is the
    // error in pixels times the scale.
    let (mut to_unit1, mut to_unit2) = (normalisation(points1)?, normalisation(points2)?);
    let scale = to_unit1.m11.min(to_unit2.m11);
    to_unit1 = with_scale(&to_unit1, scale);
    to_unit2 = with_scale(&to_unit2, scale);
    let pair = |(x1, x2): (&Vector2<f64>, &Vector2<f64>)| {
        Correspondence::of_points(&(to_unit1 * x1.push(1.0)).xy(), &(to_unit2 * x2.push(1.0)).xy())
    };
    let pairs = Correspondences::new(points1.iter().zip(points2).map(pair).collect());
    let report = ransac(&Fundamental { pairs, px_per_unit: 1.0 / scale }, options)?;
    Some(report.map(|f| (to_unit2.transpose() * f * to_unit1).normalize()))
}

/// Replaces the scale of a normalisation, `[s 0 -s cx; 0 s -s cy; 0 0 1]`.
fn with_scale(normalisation: &Matrix3<f64>, scale: f64) -> Matrix3<f64> {
    let mut scaled = normalisation * (scale / normalisation.m11);
    scaled.m33 = 1.0;
    scaled
}

/// The RANSAC problem of the fundamental matrix, in normalised coordinates.
struct Fundamental {
    pairs: Correspondences,
    px_per_unit: f64,
}

impl Estimator for Fundamental {
    type Model = Matrix3<f64>;
    const SAMPLE_SIZE: usize = 7;

    fn num_data(&self) -> usize {
        self.pairs.len()
    }

    fn models(&self, sample: &[usize], models: &mut Vec<Matrix3<f64>>) {
        let points1: [Vector2<f64>; 7] = std::array::from_fn(|i| self.pairs[sample[i]].y1.xy());
        let points2: [Vector2<f64>; 7] = std::array::from_fn(|i| self.pairs[sample[i]].y2.xy());
        models.extend(solvers::fundamental_7pt(&points1, &points2));
    }

    fn squared_residuals(&self, model: &Matrix3<f64>, range: Range<usize>, squared: &mut [f64]) {
        self.pairs.squared_errors(model, self.px_per_unit * self.px_per_unit, range, squared);
    }

    fn refine(&self, model: &Matrix3<f64>, data: &[usize], loss: Loss) -> Option<Matrix3<f64>> {
        let start = OrthonormalFundamental::of(model)?;
        let problem =
            SampsonFundamental { pairs: self.pairs.subset(data), px_per_unit: self.px_per_unit };
        Some(minimize(&problem, &start, loss, MAX_LM_ITERATIONS).matrix())
    }
}

/// The orthonormal representation F = U diag(1, σ, 0) Vᵀ: seven degrees of freedom of rank two
/// (Bartoli and Sturm 2004, "Nonlinear estimation of the fundamental matrix with minimal
/// parameters").
#[derive(Clone)]
struct OrthonormalFundamental {
    u: UnitQuaternion<f64>,
    v: UnitQuaternion<f64>,
    sigma: f64,
}

impl OrthonormalFundamental {
    /// The representation of the rank-two matrix nearest to `f`, up to scale.
    fn of(f: &Matrix3<f64>) -> Option<Self> {
        let svd = f.try_svd(true, true, f64::EPSILON, 0)?;
        let (u, v_t) = (svd.u?, svd.v_t?);
        let mut order = [0, 1, 2];
        order.sort_by(|&i, &j| svd.singular_values[j].total_cmp(&svd.singular_values[i]));
        let rotation = |columns: [Vector3<f64>; 3]| {
            // F does not depend on the third column: its sign is chosen to give a rotation.
            let third = columns[0].cross(&columns[1]);
            let matrix = Matrix3::from_columns(&[columns[0], columns[1], third]);
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix))
        };
        let sigma = svd.singular_values[order[1]] / svd.singular_values[order[0]];
        sigma.is_finite().then(|| Self {
            u: rotation(order.map(|i| u.column(i).into_owned())),
            v: rotation(order.map(|i| v_t.row(i).transpose())),
            sigma,
        })
    }

    /// The fundamental matrix F.
    fn matrix(&self) -> Matrix3<f64> {
        let diagonal = Matrix3::from_diagonal(&Vector3::new(1.0, self.sigma, 0.0));
        self.u.to_rotation_matrix().matrix()
            * diagonal
            * self.v.to_rotation_matrix().matrix().transpose()
    }
}

/// Minimises the Sampson error over the fundamental matrix.
struct SampsonFundamental {
    pairs: CorrespondenceSubset,
    px_per_unit: f64,
}

/// The tangent: left perturbations of U and of V, then σ.
impl Problem<7> for SampsonFundamental {
    type Value = OrthonormalFundamental;

    fn plus(
        &self,
        value: &OrthonormalFundamental,
        delta: &SVector<f64, 7>,
    ) -> OrthonormalFundamental {
        OrthonormalFundamental {
            u: so3::exp(&delta.fixed_rows::<3>(0).into_owned()) * value.u,
            v: so3::exp(&delta.fixed_rows::<3>(3).into_owned()) * value.v,
            sigma: value.sigma + delta[6],
        }
    }

    fn linearize(&self, value: &OrthonormalFundamental, normal: &mut NormalEquations<7>) {
        let f = value.matrix();
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| so3::hat(&axis));
        let d_sigma = (value.u * Vector3::y()) * (value.v * Vector3::y()).transpose();
        // Derivatives of F with respect to the tangent components.
        let directions: [Matrix3<f64>; 7] = [
            axes[0] * f,
            axes[1] * f,
            axes[2] * f,
            -f * axes[0],
            -f * axes[1],
            -f * axes[2],
            d_sigma,
        ];
        self.pairs.linearize(&f, self.px_per_unit, &directions, normal);
    }
}
