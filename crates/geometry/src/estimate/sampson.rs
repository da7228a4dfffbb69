//! The Sampson error of an epipolar constraint in pixels, for any camera model, and its derivative
//! with respect to the matrix.
//!
//! The error is the constraint C = y₂ᵀ M y₁ divided by the norm of its gradient with respect to the
//! pixels: r = C / √(|J₂ᵀ M y₁|² + |J₁ᵀ Mᵀ y₂|²) with Jᵢ = d yᵢ / d pixelᵢ. For a fundamental
//! matrix y = (x, y, 1) and J = (I, 0), which gives the usual Sampson error (Hartley and Zisserman
//! 2004, equation 11.9). For an essential matrix y is a unit ray.

use std::ops::{Index, Range};

use nalgebra::{Matrix3, Matrix3x2, Matrix3x4, SMatrix, SVector, Vector2, Vector3};
use tiepoint_simd::dispatch;

use super::robust_weights::robust_weights;
use crate::simd::{LANES, Lanes, blocks_of, pack, store};
use crate::small_lm::NormalEquations;
use crate::{CameraModel, Intrinsics, Loss, Rigid3};

/// Correspondences, and the same packed for SIMD.
pub(super) struct Correspondences {
    pairs: Vec<Correspondence>,
    /// Components as in [`Correspondence::components`]: y₁, y₂, J₁, J₂.
    blocks: Vec<[Lanes; 18]>,
}

impl Correspondences {
    pub(super) fn new(pairs: Vec<Correspondence>) -> Self {
        let blocks = pack(&pairs, Correspondence::components);
        Self { pairs, blocks }
    }

    /// The correspondences with the given indices, packed for linearisation.
    pub(super) fn subset(&self, indices: &[usize]) -> CorrespondenceSubset {
        CorrespondenceSubset {
            blocks: pack(indices, |&i| self.pairs[i].components()),
            len: indices.len(),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.pairs.len()
    }

    /// The squared errors of the correspondences in `range` under `m`, multiplied by `factor`.
    pub(super) fn squared_errors(
        &self,
        m: &Matrix3<f64>,
        factor: f64,
        range: Range<usize>,
        squared: &mut [f64],
    ) {
        squared_errors(&self.blocks, m, factor, range, squared);
    }

    /// The squared errors under the essential matrix of a pose `cam2_from_cam1`. The error is
    /// infinite if the rays violate the cheirality constraint, unless the angle between them has a
    /// squared sine below `parallel_sin2`.
    pub(super) fn squared_errors_in_front(
        &self,
        pose: &Rigid3,
        parallel_sin2: f64,
        range: Range<usize>,
        squared: &mut [f64],
    ) {
        squared_errors_in_front(&self.blocks, &pose.to_matrix(), parallel_sin2, range, squared);
    }
}

/// A subset of the correspondences, packed for [`CorrespondenceSubset::linearize`].
pub(super) struct CorrespondenceSubset {
    blocks: Vec<[Lanes; 18]>,
    len: usize,
}

/// Number of sums: the gradient by the nine matrix entries, the lower triangle of their Hessian,
/// and the cost.
const NUM_SUMS: usize = 9 + 45 + 1;

impl CorrespondenceSubset {
    /// Adds the errors under `m`, multiplied by `factor`, and their derivatives along `directions`
    /// of `m` to the normal equations.
    ///
    /// JᵀJ and Jᵀr are accumulated for the nine entries of `m`, eight correspondences at a time.
    /// The chain rule with `directions`, which are the same for all correspondences, follows at the
    /// end.
    pub(super) fn linearize<const N: usize>(
        &self,
        m: &Matrix3<f64>,
        factor: f64,
        directions: &[Matrix3<f64>; N],
        normal: &mut NormalEquations<N>,
    ) {
        let mut lanes = [[0.0; LANES]; NUM_SUMS];
        accumulate(&self.blocks, self.len, m, factor, normal.loss(), &mut lanes);
        let sums = lanes.map(|lanes| lanes.iter().sum::<f64>());
        let [gradient @ .., cost] = &sums;
        let (gradient, products) = gradient.split_at(9);
        let hessian = SMatrix::<f64, 9, 9>::from_fn(|i, j| {
            let (row, column) = (i.max(j), i.min(j));
            products[row * (row + 1) / 2 + column]
        });
        let basis = SMatrix::<f64, 9, N>::from_fn(|entry, k| directions[k][(entry / 3, entry % 3)]);
        normal.add_sums(
            &(basis.transpose() * hessian * basis),
            &(basis.transpose() * SVector::<f64, 9>::from_column_slice(gradient)),
            *cost,
        );
    }
}

dispatch! {
    /// Accumulates the normal equations of the nine matrix entries over the correspondences, with
    /// the errors and derivatives of `Correspondence::error_with_derivative`: Jᵀr, the lower
    /// triangle of JᵀJ by rows, and half of ρ. Correspondences without a finite derivative are
    /// skipped.
    fn accumulate(
        blocks: &[[Lanes; 18]],
        len: usize,
        m: &Matrix3<f64>,
        factor: f64,
        loss: Loss,
        sums: &mut [Lanes; NUM_SUMS],
    ) {
        let [mut derivative, mut weighted] = [[[0.0; LANES]; 9]; 2];
        let [mut error, mut squared, mut rho, mut weight] = [[0.0; LANES]; 4];
        for (index, block) in blocks.iter().enumerate() {
            let [y1x, y1y, y1z, y2x, y2y, y2z, j1 @ .., _, _, _, _, _, _] = block;
            let [_, _, _, _, _, _, _, _, _, _, _, _, j2 @ ..] = block;
            for l in 0..LANES {
                let (y1, y2) = ([y1x[l], y1y[l], y1z[l]], [y2x[l], y2y[l], y2z[l]]);
                let [line2, line1] = [times(m, y1), transposed_times(m, y2)];
                let product = dot(y2, line2);
                let ([a, b], [c, d]) = (in_pixels(j1, l, line1), in_pixels(j2, l, line2));
                let norm2 = (a * a + b * b) + (c * c + d * d);
                let inverse = factor / norm2.sqrt();
                let ratio = product / norm2;
                // d(norm² / 2) by the epipolar lines, multiplied by product / norm²; below, by the
                // matrix entries.
                let by_line1 = [
                    (j1[0][l] * a + j1[3][l] * b) * ratio,
                    (j1[1][l] * a + j1[4][l] * b) * ratio,
                    (j1[2][l] * a + j1[5][l] * b) * ratio,
                ];
                let by_line2 = [
                    (j2[0][l] * c + j2[3][l] * d) * ratio,
                    (j2[1][l] * c + j2[4][l] * d) * ratio,
                    (j2[2][l] * c + j2[5][l] * d) * ratio,
                ];
                // Skips padding, and correspondences at both epipoles.
                let is_valid = (index * LANES + l < len) & (inverse < f64::INFINITY);
                error[l] = if is_valid { product * inverse } else { 0.0 };
                for (k, lanes) in derivative.iter_mut().enumerate() {
                    let (row, column) = (k / 3, k % 3);
                    let by_lines = by_line2[row] * y1[column] + y2[row] * by_line1[column];
                    let entry = (y2[row] * y1[column] - by_lines) * inverse;
                    lanes[l] = if is_valid { entry } else { 0.0 };
                }
            }
            let num_valid = LANES.min(len - index * LANES);
            for l in 0..LANES {
                squared[l] = error[l] * error[l];
            }
            robust_weights(loss, &squared, num_valid, &mut rho, &mut weight);
            for k in 0..9 {
                for l in 0..LANES {
                    weighted[k][l] = weight[l] * derivative[k][l];
                }
            }
            let [by_entry @ .., cost] = &mut *sums;
            let (gradient, products) = by_entry.split_at_mut(9);
            for k in 0..9 {
                for l in 0..LANES {
                    gradient[k][l] += weighted[k][l] * error[l];
                }
                for j in 0..k + 1 {
                    for l in 0..LANES {
                        products[k * (k + 1) / 2 + j][l] += weighted[k][l] * derivative[j][l];
                    }
                }
            }
            for l in 0..LANES {
                cost[l] += 0.5 * rho[l];
            }
        }
    }
}

impl Index<usize> for Correspondences {
    type Output = Correspondence;
    fn index(&self, index: usize) -> &Correspondence {
        &self.pairs[index]
    }
}

dispatch! {
    /// The Sampson errors of [`Correspondences::squared_errors`], eight at a time.
    fn squared_errors(
        blocks: &[[Lanes; 18]],
        m: &Matrix3<f64>,
        factor: f64,
        range: Range<usize>,
        squared: &mut [f64],
    ) {
        for index in blocks_of(&range) {
            let [y1x, y1y, y1z, y2x, y2y, y2z, j1 @ .., _, _, _, _, _, _] = &blocks[index];
            let [_, _, _, _, _, _, _, _, _, _, _, _, j2 @ ..] = &blocks[index];
            let mut lanes = [0.0; LANES];
            for l in 0..LANES {
                let (y1, y2) = ([y1x[l], y1y[l], y1z[l]], [y2x[l], y2y[l], y2z[l]]);
                let [line2, line1] = [times(m, y1), transposed_times(m, y2)];
                let product = dot(y2, line2);
                let ([a, b], [c, d]) = (in_pixels(j1, l, line1), in_pixels(j2, l, line2));
                lanes[l] = product * product * factor / ((a * a + b * b) + (c * c + d * d));
            }
            store(&lanes, index, &range, squared);
        }
    }
}

dispatch! {
    /// The Sampson errors with the cheirality constraint of
    /// [`rays_meet_in_front`](crate::epipolar::rays_meet_in_front), eight at a time.
    fn squared_errors_in_front(
        blocks: &[[Lanes; 18]],
        pose: &Matrix3x4<f64>,
        parallel_sin2: f64,
        range: Range<usize>,
        squared: &mut [f64],
    ) {
        let rotation = pose.fixed_columns::<3>(0).into_owned();
        let t = [pose.m14, pose.m24, pose.m34];
        for index in blocks_of(&range) {
            let [y1x, y1y, y1z, y2x, y2y, y2z, j1 @ .., _, _, _, _, _, _] = &blocks[index];
            let [_, _, _, _, _, _, _, _, _, _, _, _, j2 @ ..] = &blocks[index];
            let mut lanes = [0.0; LANES];
            for l in 0..LANES {
                let (y1, y2) = ([y1x[l], y1y[l], y1z[l]], [y2x[l], y2y[l], y2z[l]]);
                let rotated = times(&rotation, y1);
                // E y₁ = t × R y₁ and Eᵀ y₂ = Rᵀ (y₂ × t).
                let line2 = cross(t, rotated);
                let moment = cross(y2, t);
                let line1 = transposed_times(&rotation, moment);
                let product = dot(y2, line2);
                let ([a, b], [c, d]) = (in_pixels(j1, l, line1), in_pixels(j2, l, line2));
                let error = product * product / ((a * a + b * b) + (c * c + d * d));
                let (cosine, along1, along2) = (dot(rotated, y2), dot(rotated, t), dot(y2, t));
                let in_front = (cosine * along2 > along1) & (along2 > cosine * along1);
                let parallel = (1.0 - cosine * cosine < parallel_sin2) & (cosine > 0.0);
                lanes[l] = if in_front | parallel { error } else { f64::INFINITY };
            }
            store(&lanes, index, &range, squared);
        }
    }
}

#[inline(always)]
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// M y.
#[inline(always)]
fn times(m: &Matrix3<f64>, y: [f64; 3]) -> [f64; 3] {
    [dot([m.m11, m.m12, m.m13], y), dot([m.m21, m.m22, m.m23], y), dot([m.m31, m.m32, m.m33], y)]
}

/// Mᵀ y.
#[inline(always)]
fn transposed_times(m: &Matrix3<f64>, y: [f64; 3]) -> [f64; 3] {
    [dot([m.m11, m.m21, m.m31], y), dot([m.m12, m.m22, m.m32], y), dot([m.m13, m.m23, m.m33], y)]
}

/// Jᵀ times an epipolar line, for the J of lane `l`.
#[inline(always)]
fn in_pixels(j: &[Lanes; 6], l: usize, line: [f64; 3]) -> [f64; 2] {
    [dot([j[0][l], j[1][l], j[2][l]], line), dot([j[3][l], j[4][l], j[5][l]], line)]
}

#[inline(always)]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A correspondence of two homogeneous points or unit rays.
#[derive(Clone, Copy, Debug)]
pub(super) struct Correspondence {
    pub(super) y1: Vector3<f64>,
    pub(super) y2: Vector3<f64>,
    /// d y₁ / d pixel₁.
    d1: Matrix3x2<f64>,
    /// d y₂ / d pixel₂.
    d2: Matrix3x2<f64>,
}

impl Correspondence {
    /// From image points, for a fundamental matrix.
    pub(super) fn of_points(x1: &Vector2<f64>, x2: &Vector2<f64>) -> Self {
        let d = Matrix3x2::identity();
        Self { y1: x1.push(1.0), y2: x2.push(1.0), d1: d, d2: d }
    }

    /// From the unit rays of two pixels; `None` if a pixel has no ray.
    pub(super) fn of_pixels(
        pixel1: &Vector2<f64>,
        pixel2: &Vector2<f64>,
        intrinsics1: &Intrinsics,
        intrinsics2: &Intrinsics,
    ) -> Option<Self> {
        let (y1, d1) = ray_with_jacobian(pixel1, intrinsics1)?;
        let (y2, d2) = ray_with_jacobian(pixel2, intrinsics2)?;
        Some(Self { y1, y2, d1, d2 })
    }

    /// The squared error under the matrix `m`: the reference implementation of
    /// [`Correspondences::squared_errors`].
    #[cfg(test)]
    fn squared_error(&self, m: &Matrix3<f64>) -> f64 {
        let (line2, line1) = (m * self.y1, m.tr_mul(&self.y2));
        let product = self.y2.dot(&line2);
        product * product
            / (self.d2.tr_mul(&line2).norm_squared() + self.d1.tr_mul(&line1).norm_squared())
    }

    /// y₁, y₂, J₁, J₂; the matrices column by column.
    fn components(&self) -> [f64; 18] {
        let Self { y1, y2, d1, d2 } = self;
        let mut components = [0.0; 18];
        components[..3].copy_from_slice(y1.as_slice());
        components[3..6].copy_from_slice(y2.as_slice());
        components[6..12].copy_from_slice(d1.as_slice());
        components[12..].copy_from_slice(d2.as_slice());
        components
    }

    /// The signed error and its derivative by the entries of `m`: the reference implementation of
    /// [`CorrespondenceSubset::linearize`]. `None` at both epipoles.
    #[cfg(test)]
    fn error_with_derivative(&self, m: &Matrix3<f64>) -> Option<(f64, Matrix3<f64>)> {
        let (line2, line1) = (m * self.y1, m.tr_mul(&self.y2));
        let product = self.y2.dot(&line2);
        let (g2, g1) = (self.d2.tr_mul(&line2), self.d1.tr_mul(&line1));
        let norm2 = g2.norm_squared() + g1.norm_squared();
        let inverse = 1.0 / norm2.sqrt();
        if !inverse.is_finite() {
            return None;
        }
        let d_norm = self.d2 * g2 * self.y1.transpose() + self.y2 * (self.d1 * g1).transpose();
        let derivative = (self.y2 * self.y1.transpose() - d_norm * (product / norm2)) * inverse;
        Some((product * inverse, derivative))
    }
}

/// The unit ray of a pixel and its derivative by the pixel: the pseudo-inverse of the Jacobian of
/// the projection, whose null space is the ray.
fn ray_with_jacobian(
    pixel: &Vector2<f64>,
    intrinsics: &Intrinsics,
) -> Option<(Vector3<f64>, Matrix3x2<f64>)> {
    let ray = intrinsics.unproject(pixel)?;
    let d_point = with_camera_model!(intrinsics, M, params => {
        M::project_with_jacobian(params, &ray)?.d_point
    });
    let d_ray = d_point.transpose() * (d_point * d_point.transpose()).try_inverse()?;
    Some((ray, d_ray))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::epipolar::{essential_from_pose, rays_meet_in_front};
    use crate::{CameraModelKind, Rng};

    fn pairs(camera: &Intrinsics) -> Vec<Correspondence> {
        let mut rng = Rng::stream(1, &[]);
        let mut pixel = || Vector2::new(1000.0 * rng.uniform(), 800.0 * rng.uniform());
        (0..37)
            .filter_map(|_| Correspondence::of_pixels(&pixel(), &pixel(), camera, camera))
            .collect()
    }

    const RANGES: [Range<usize>; 6] = [0..37, 0..8, 5..6, 7..31, 36..37, 12..12];

    #[test]
    fn squared_errors_match_the_reference() {
        let pairs = pairs(&Intrinsics::centred(CameraModelKind::OpencvFisheye, 400.0, 1000, 800));
        let m = Matrix3::from_fn(|i, j| (1 + i + 3 * j) as f64 * if i == j { -1.0 } else { 0.5 });
        let packed = Correspondences::new(pairs.clone());
        for range in RANGES {
            let mut squared = vec![f64::NAN; range.len()];
            packed.squared_errors(&m, 2.0, range.clone(), &mut squared);
            for (squared, pair) in squared.iter().zip(&pairs[range]) {
                let expected = 2.0 * pair.squared_error(&m);
                assert!((squared - expected).abs() <= 1e-12 * expected, "{squared} {expected}");
            }
        }
    }

    #[test]
    fn normal_equations_match_the_reference() {
        /// Rounding of sums of 37 products in another order.
        const ROUNDING: f64 = 1e-10;
        let pairs = pairs(&Intrinsics::centred(CameraModelKind::OpencvFisheye, 400.0, 1000, 800));
        let m = Matrix3::from_fn(|i, j| (1 + i + 3 * j) as f64 * if i == j { -1.0 } else { 0.5 });
        let directions: [Matrix3<f64>; 4] =
            std::array::from_fn(|k| Matrix3::from_fn(|i, j| (k * i) as f64 - (j * j) as f64 + 0.5));
        let packed = Correspondences::new(pairs.clone());
        let everything: Vec<usize> = (0..pairs.len()).collect();
        let some: Vec<usize> = (0..pairs.len()).step_by(3).collect();
        for chosen in [everything, some, vec![36]] {
            for loss in [Loss::Trivial, Loss::Truncated(150.0), Loss::Cauchy(100.0)] {
                let (mut fast, mut slow) = (NormalEquations::new(loss), NormalEquations::new(loss));
                packed.subset(&chosen).linearize(&m, 2.0, &directions, &mut fast);
                for &i in &chosen {
                    let (error, derivative) = pairs[i].error_with_derivative(&m).unwrap();
                    let jacobian =
                        SMatrix::<f64, 1, 4>::from_fn(|_, k| 2.0 * derivative.dot(&directions[k]));
                    slow.add(&SVector::<f64, 1>::new(2.0 * error), &jacobian);
                }
                assert!(fast.relative_difference(&slow) < ROUNDING);
            }
        }
    }

    #[test]
    fn squared_errors_with_cheirality_match_the_reference() {
        let pairs = pairs(&Intrinsics::centred(CameraModelKind::OpencvFisheye, 400.0, 1000, 800));
        let pose =
            Rigid3::from_axis_angle(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.6, 0.0, 0.8));
        let packed = Correspondences::new(pairs.clone());
        let mut num_behind = 0;
        // Large enough that some of the correspondences count as parallel.
        let parallel = 0.2_f64;
        for range in RANGES {
            let mut squared = vec![f64::NAN; range.len()];
            packed.squared_errors_in_front(
                &pose,
                parallel.sin().powi(2),
                range.clone(),
                &mut squared,
            );
            for (squared, pair) in squared.iter().zip(&pairs[range]) {
                let is_parallel = (pose.rotation * pair.y1).angle(&pair.y2) < parallel;
                if is_parallel || rays_meet_in_front(&pair.y1, &pair.y2, &pose) {
                    let expected = pair.squared_error(&essential_from_pose(&pose));
                    assert!((squared - expected).abs() <= 1e-9 * expected, "{squared} {expected}");
                } else {
                    num_behind += 1;
                    assert_eq!(*squared, f64::INFINITY);
                }
            }
        }
        assert!(num_behind > 0);
    }
}
