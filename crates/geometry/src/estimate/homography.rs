//! The homography between two images of a plane, or of two images from the same camera centre.

use std::ops::Range;

use nalgebra::{Matrix3, SMatrix, SVector, Vector2};
use tiepoint_simd::dispatch;

use super::robust_weights::robust_weights;
use crate::ransac::{Estimator, RansacOptions, Report, ransac};
use crate::simd::{LANES, Lanes, blocks_of, pack, store};
use crate::small_lm::{MAX_LM_ITERATIONS, NormalEquations, Problem, minimize};
use crate::solvers::normalisation;
use crate::{Loss, solvers};

/// Estimates the homography, of Frobenius norm 1, that maps `points1[i]` to `points2[i]`.
///
/// Minimal models come from the four-point solver; refinement minimises the transfer error in
/// image 2, which `options.max_error` bounds, in pixels.
pub fn homography(
    points1: &[Vector2<f64>],
    points2: &[Vector2<f64>],
    options: &RansacOptions,
) -> Option<Report<Matrix3<f64>>> {
    let count = points1.len().min(points2.len());
    let (to_unit1, to_unit2) =
        (normalisation(&points1[..count])?, normalisation(&points2[..count])?);
    let apply = |m: &Matrix3<f64>, points: &[Vector2<f64>]| -> Vec<Vector2<f64>> {
        points[..count].iter().map(|p| (m * p.push(1.0)).xy()).collect()
    };
    let (points1, points2) = (apply(&to_unit1, points1), apply(&to_unit2, points2));
    let pairs: Vec<[f64; 4]> =
        points1.iter().zip(&points2).map(|(p, q)| [p.x, p.y, q.x, q.y]).collect();
    let estimator =
        Homography { blocks: pack(&pairs, |pair| *pair), pairs, px_per_unit: 1.0 / to_unit2.m11 };
    let px_from_unit2 = to_unit2.try_inverse()?;
    let report = ransac(&estimator, options)?;
    Some(report.map(|h| (px_from_unit2 * h * to_unit1).normalize()))
}

/// The RANSAC problem of the homography, in normalised coordinates.
struct Homography {
    /// x and y in the first image, then in the second.
    pairs: Vec<[f64; 4]>,
    /// The same, packed for SIMD.
    blocks: Vec<[Lanes; 4]>,
    px_per_unit: f64,
}

impl Estimator for Homography {
    type Model = Matrix3<f64>;
    const SAMPLE_SIZE: usize = 4;

    fn num_data(&self) -> usize {
        self.pairs.len()
    }

    fn models(&self, sample: &[usize], models: &mut Vec<Matrix3<f64>>) {
        let pairs: [[f64; 4]; 4] = std::array::from_fn(|i| self.pairs[sample[i]]);
        let [points1, points2] =
            [0, 2].map(|at| pairs.map(|pair| Vector2::new(pair[at], pair[at + 1])));
        models.extend(solvers::homography_4pt(&points1, &points2));
    }

    fn squared_residuals(&self, model: &Matrix3<f64>, range: Range<usize>, squared: &mut [f64]) {
        squared_errors(&self.blocks, model, self.px_per_unit * self.px_per_unit, range, squared);
    }

    fn refine(&self, model: &Matrix3<f64>, data: &[usize], loss: Loss) -> Option<Matrix3<f64>> {
        // The entry h₃₃ is the depth at the centroid of the points. It is zero only if the centroid
        // is on the line that maps to infinity.
        let start = model / model.m33;
        if model.m33 <= 0.0 || !start.iter().all(|v| v.is_finite()) {
            return None;
        }
        let problem = TransferError {
            blocks: pack(data, |&i| self.pairs[i]),
            len: data.len(),
            px_per_unit: self.px_per_unit,
        };
        Some(minimize(&problem, &start, loss, MAX_LM_ITERATIONS))
    }
}

/// Minimises the transfer error in image 2.
struct TransferError {
    blocks: Vec<[Lanes; 4]>,
    len: usize,
    px_per_unit: f64,
}

/// The tangent: the entries row by row, without h₃₃, which stays one.
impl Problem<8> for TransferError {
    type Value = Matrix3<f64>;

    fn plus(&self, value: &Matrix3<f64>, delta: &SVector<f64, 8>) -> Matrix3<f64> {
        Matrix3::from_fn(|row, column| {
            value[(row, column)] + delta.get(3 * row + column).copied().unwrap_or(0.0)
        })
    }

    fn linearize(&self, value: &Matrix3<f64>, normal: &mut NormalEquations<8>) {
        let mut lanes = [[0.0; LANES]; NUM_SUMS];
        accumulate(&self.blocks, self.len, value, self.px_per_unit, normal.loss(), &mut lanes);
        let [cost, products @ .., g0, g1, g2, g3, g4, g5, g6, g7] =
            lanes.map(|lanes| lanes.iter().sum::<f64>());
        let [aa @ .., b0, b1, b2, c0, c1, c2, d0, d1, d2, e0, e1, e2, f0, f1, f2] = products;
        let [a0, a1, a2, a3, a4, a5] = aa;
        // u depends on the first row of H and v on the second, with the same derivatives; both
        // depend on the third row.
        #[rustfmt::skip]
        let hessian = SMatrix::<f64, 8, 8>::from_row_slice(&[
            a0, a1, a3, 0., 0., 0., b0, c0,
            a1, a2, a4, 0., 0., 0., b1, c1,
            a3, a4, a5, 0., 0., 0., b2, c2,
            0., 0., 0., a0, a1, a3, d0, e0,
            0., 0., 0., a1, a2, a4, d1, e1,
            0., 0., 0., a3, a4, a5, d2, e2,
            b0, b1, b2, d0, d1, d2, f0, f1,
            c0, c1, c2, e0, e1, e2, f1, f2,
        ]);
        normal.add_sums(&hessian, &SVector::from([g0, g1, g2, g3, g4, g5, g6, g7]), cost);
    }
}

/// Number of sums: the cost, the 21 different entries of JᵀJ, and the eight entries of Jᵀr.
const NUM_SUMS: usize = 1 + 21 + 8;

dispatch! {
    /// Squared transfer errors in image 2, eight at a time; infinite for points behind the camera.
    fn squared_errors(
        blocks: &[[Lanes; 4]],
        h: &Matrix3<f64>,
        factor: f64,
        range: Range<usize>,
        squared: &mut [f64],
    ) {
        for index in blocks_of(&range) {
            let [x1, y1, x2, y2] = &blocks[index];
            let mut lanes = [0.0; LANES];
            for l in 0..LANES {
                let z = h.m31 * x1[l] + h.m32 * y1[l] + h.m33;
                let u = (h.m11 * x1[l] + h.m12 * y1[l] + h.m13) / z - x2[l];
                let v = (h.m21 * x1[l] + h.m22 * y1[l] + h.m23) / z - y2[l];
                lanes[l] = if z > 0.0 { (u * u + v * v) * factor } else { f64::INFINITY };
            }
            store(&lanes, index, &range, squared);
        }
    }
}

dispatch! {
    /// Accumulates the normal equations over the correspondences. The order of the sums is: half of
    /// ρ (0); JᵀJ within the first row of H (1 to 6); JᵀJ of the first row with h₃₁ and with h₃₂
    /// (7 to 12), and of the second row likewise (13 to 18); JᵀJ within the third row (19 to 21);
    /// Jᵀr (22 to 29). A point behind the camera makes the cost infinite.
    fn accumulate(
        blocks: &[[Lanes; 4]],
        len: usize,
        h: &Matrix3<f64>,
        px_per_unit: f64,
        loss: Loss,
        sums: &mut [Lanes; NUM_SUMS],
    ) {
        let [mut du, mut dv] = [[[0.0; LANES]; 5]; 2];
        let [mut wu, mut wv] = [[[0.0; LANES]; 5]; 2];
        let [mut ru, mut rv, mut squared, mut rho, mut weight] = [[0.0; LANES]; 5];
        for (index, block) in blocks.iter().enumerate() {
            let [x1, y1, x2, y2] = block;
            let num_valid = LANES.min(len - index * LANES);
            for l in 0..LANES {
                let is_valid = index * LANES + l < len;
                let z = h.m31 * x1[l] + h.m32 * y1[l] + h.m33;
                let u = (h.m11 * x1[l] + h.m12 * y1[l] + h.m13) / z;
                let v = (h.m21 * x1[l] + h.m22 * y1[l] + h.m23) / z;
                let scale = if is_valid { px_per_unit } else { 0.0 };
                let w = scale / z;
                ru[l] = (u - x2[l]) * scale;
                rv[l] = (v - y2[l]) * scale;
                let s = ru[l] * ru[l] + rv[l] * rv[l];
                squared[l] = if z > 0.0 { s } else { f64::INFINITY };
                // Derivatives by the entries of the own row of H, then by h₃₁ and h₃₂.
                du[0][l] = x1[l] * w;
                du[1][l] = y1[l] * w;
                du[2][l] = w;
                du[3][l] = -u * x1[l] * w;
                du[4][l] = -u * y1[l] * w;
                dv[3][l] = -v * x1[l] * w;
                dv[4][l] = -v * y1[l] * w;
            }
            robust_weights(loss, &squared, num_valid, &mut rho, &mut weight);
            [dv[0], dv[1], dv[2]] = [du[0], du[1], du[2]];
            for k in 0..5 {
                for l in 0..LANES {
                    wu[k][l] = weight[l] * du[k][l];
                    wv[k][l] = weight[l] * dv[k][l];
                }
            }
            for l in 0..LANES {
                let behind = if squared[l] < f64::INFINITY { 0.0 } else { f64::INFINITY };
                sums[0][l] += 0.5 * rho[l] + behind;
            }
            for k in 0..3 {
                for j in 0..k + 1 {
                    for l in 0..LANES {
                        sums[1 + k * (k + 1) / 2 + j][l] += wu[k][l] * du[j][l];
                    }
                }
                for l in 0..LANES {
                    sums[7 + k][l] += wu[k][l] * du[3][l];
                    sums[10 + k][l] += wu[k][l] * du[4][l];
                    sums[13 + k][l] += wv[k][l] * dv[3][l];
                    sums[16 + k][l] += wv[k][l] * dv[4][l];
                    sums[22 + k][l] += wu[k][l] * ru[l];
                    sums[25 + k][l] += wv[k][l] * rv[l];
                }
            }
            for l in 0..LANES {
                sums[19][l] += wu[3][l] * du[3][l] + wv[3][l] * dv[3][l];
                sums[20][l] += wu[3][l] * du[4][l] + wv[3][l] * dv[4][l];
                sums[21][l] += wu[4][l] * du[4][l] + wv[4][l] * dv[4][l];
                sums[28][l] += wu[3][l] * ru[l] + wv[3][l] * rv[l];
                sums[29][l] += wu[4][l] * ru[l] + wv[4][l] * rv[l];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;

    /// Rounding of sums of 37 products in another order.
    const ROUNDING: f64 = 1e-10;
    const PAIRS: usize = 37;

    fn estimator() -> Homography {
        let mut rng = Rng::stream(1, &[]);
        let pairs: Vec<[f64; 4]> =
            (0..PAIRS).map(|_| std::array::from_fn(|_| 2.0 * rng.uniform() - 1.0)).collect();
        Homography { blocks: pack(&pairs, |pair| *pair), pairs, px_per_unit: 300.0 }
    }

    /// One residual and its derivative by the first eight entries of H, row by row: the reference
    /// implementation.
    fn residual(
        pair: &[f64; 4],
        h: &Matrix3<f64>,
        px_per_unit: f64,
    ) -> (Vector2<f64>, SMatrix<f64, 2, 8>) {
        let [x, y, ..] = *pair;
        let image = h * Vector2::new(x, y).push(1.0);
        let (u, v) = (image.x / image.z, image.y / image.z);
        #[rustfmt::skip]
        let jacobian = SMatrix::<f64, 2, 8>::from_row_slice(&[
            x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y,
            0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y,
        ]) * (px_per_unit / image.z);
        ((Vector2::new(u - pair[2], v - pair[3])) * px_per_unit, jacobian)
    }

    #[test]
    fn packed_errors_match_the_reference() {
        let estimator = estimator();
        let h = Matrix3::new(0.9, 0.1, 0.2, -0.2, 1.1, 0.1, 0.3, -0.2, 1.0);
        for range in [0..37, 0..8, 5..6, 7..31, 36..37, 12..12] {
            let mut squared = vec![f64::NAN; range.len()];
            estimator.squared_residuals(&h, range.clone(), &mut squared);
            for (squared, pair) in squared.iter().zip(&estimator.pairs[range]) {
                let expected = residual(pair, &h, 300.0).0.norm_squared();
                assert!((squared - expected).abs() <= ROUNDING * expected, "{squared} {expected}");
            }
        }
        let everything: Vec<usize> = (0..PAIRS).collect();
        for chosen in [everything, (0..PAIRS).step_by(3).collect(), vec![36]] {
            for loss in [Loss::Trivial, Loss::Truncated(150.0), Loss::Cauchy(100.0)] {
                let (mut fast, mut slow) = (NormalEquations::new(loss), NormalEquations::new(loss));
                let transfer = TransferError {
                    blocks: pack(&chosen, |&i| estimator.pairs[i]),
                    len: chosen.len(),
                    px_per_unit: 300.0,
                };
                transfer.linearize(&h, &mut fast);
                for &i in &chosen {
                    let (error, jacobian) = residual(&estimator.pairs[i], &h, 300.0);
                    slow.add(&error, &jacobian);
                }
                assert!(fast.relative_difference(&slow) < ROUNDING);
            }
        }
    }

    #[test]
    fn errors_behind_the_camera_are_infinite() {
        let estimator = estimator();
        // Negative depth left of x = −0.5.
        let h = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.5);
        let mut squared = vec![f64::NAN; PAIRS];
        estimator.squared_residuals(&h, 0..PAIRS, &mut squared);
        assert!(estimator.pairs.iter().any(|pair| pair[0] < -0.5));
        for (squared, pair) in squared.iter().zip(&estimator.pairs) {
            assert_eq!(*squared == f64::INFINITY, pair[0] <= -0.5);
        }
        let transfer =
            TransferError { blocks: estimator.blocks.clone(), len: PAIRS, px_per_unit: 300.0 };
        let mut normal = NormalEquations::new(Loss::Truncated(4.0));
        transfer.linearize(&h, &mut normal);
        assert!(normal.is_rejected());
    }
}
