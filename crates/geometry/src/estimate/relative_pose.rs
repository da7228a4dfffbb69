//! The relative pose of two calibrated cameras.

use std::ops::Range;

use nalgebra::{Matrix3, SVector, Vector2, Vector3};

use super::sampson::{Correspondence, CorrespondenceSubset, Correspondences};
use crate::epipolar::{essential_from_pose, poses_of_exact_essential, rays_meet_in_front};
use crate::ransac::{Estimator, RansacOptions, Report, ransac};
use crate::small_lm::{MAX_LM_ITERATIONS, NormalEquations, Problem, minimize};
use crate::{Intrinsics, Loss, Rigid3, so3, solvers};

/// Estimates `cam2_from_cam1`, with a translation of length one, from corresponding pixels.
///
/// Minimal models come from the five-point solver and the cheirality constraint; refinement
/// minimises the Sampson error. `options.max_error` is a Sampson error in pixels. Correspondences
/// that violate the cheirality constraint, or have a pixel without a ray, are outliers.
pub fn relative_pose(
    pixels1: &[Vector2<f64>],
    pixels2: &[Vector2<f64>],
    intrinsics1: &Intrinsics,
    intrinsics2: &Intrinsics,
    options: &RansacOptions,
) -> Option<Report<Rigid3>> {
    // Pixels without a ray are outliers.
    let (indices, pairs): (Vec<usize>, Vec<Correspondence>) = pixels1
        .iter()
        .zip(pixels2)
        .enumerate()
        .filter_map(|(i, (p1, p2))| {
            Some((i, Correspondence::of_pixels(p1, p2, intrinsics1, intrinsics2)?))
        })
        .unzip();
    let focal_px = 0.5 * (intrinsics1.mean_focal_px() + intrinsics2.mean_focal_px());
    let parallel_sin2 = (options.max_error / focal_px).powi(2);
    let mut report =
        ransac(&RelativePose { pairs: Correspondences::new(pairs), parallel_sin2 }, options)?;
    let mut inliers = vec![false; pixels1.len().min(pixels2.len())];
    for (&index, &inlier) in indices.iter().zip(&report.inliers) {
        inliers[index] = inlier;
    }
    report.inliers = inliers;
    Some(report)
}

/// Estimates the essential matrix of norm √2: E = \[t\]ₓ R of the pose of [`relative_pose`].
pub fn essential(
    pixels1: &[Vector2<f64>],
    pixels2: &[Vector2<f64>],
    intrinsics1: &Intrinsics,
    intrinsics2: &Intrinsics,
    options: &RansacOptions,
) -> Option<Report<Matrix3<f64>>> {
    let report = relative_pose(pixels1, pixels2, intrinsics1, intrinsics2, options)?;
    Some(report.map(|pose| essential_from_pose(&pose)))
}

/// The RANSAC problem of the relative pose.
struct RelativePose {
    pairs: Correspondences,
    /// Squared sine of the angle of the error threshold. For rays that are parallel to within this
    /// angle, noise decides the sign of the depths: they are exempt from the cheirality constraint.
    parallel_sin2: f64,
}

impl Estimator for RelativePose {
    type Model = Rigid3;
    const SAMPLE_SIZE: usize = 5;

    fn num_data(&self) -> usize {
        self.pairs.len()
    }

    fn models(&self, sample: &[usize], models: &mut Vec<Rigid3>) {
        let rays1: [Vector3<f64>; 5] = std::array::from_fn(|i| self.pairs[sample[i]].y1);
        let rays2: [Vector3<f64>; 5] = std::array::from_fn(|i| self.pairs[sample[i]].y2);
        for essential in solvers::essential_5pt(&rays1, &rays2) {
            let is_possible = |pose: &Rigid3| {
                rays1.iter().zip(&rays2).all(|(a, b)| rays_meet_in_front(a, b, pose))
            };
            models.extend(poses_of_exact_essential(&essential).into_iter().find(is_possible));
        }
    }

    fn squared_residuals(&self, model: &Rigid3, range: Range<usize>, squared: &mut [f64]) {
        self.pairs.squared_errors_in_front(model, self.parallel_sin2, range, squared);
    }

    fn refine(&self, model: &Rigid3, data: &[usize], loss: Loss) -> Option<Rigid3> {
        Some(minimize(&SampsonPose(self.pairs.subset(data)), model, loss, MAX_LM_ITERATIONS))
    }
}

/// Minimises the Sampson error over the pose.
struct SampsonPose(CorrespondenceSubset);

/// An orthonormal basis of the tangent plane of the unit sphere at `direction`.
fn tangents(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let mut axis = Vector3::zeros();
    axis[direction.iamin()] = 1.0;
    let first = direction.cross(&axis).normalize();
    [first, direction.cross(&first)]
}

/// The tangent: a left perturbation of the rotation, then two components of the translation in the
/// tangent plane of the unit sphere.
impl Problem<5> for SampsonPose {
    type Value = Rigid3;

    fn plus(&self, value: &Rigid3, delta: &SVector<f64, 5>) -> Rigid3 {
        let [a, b] = tangents(&value.translation);
        let rotation = so3::exp(&delta.fixed_rows::<3>(0).into_owned()) * value.rotation;
        Rigid3 {
            rotation,
            translation: (value.translation + a * delta[3] + b * delta[4]).normalize(),
        }
    }

    fn linearize(&self, value: &Rigid3, normal: &mut NormalEquations<5>) {
        let rotation = *value.rotation.to_rotation_matrix().matrix();
        let t_hat = so3::hat(&value.translation);
        let essential = t_hat * rotation;
        let [a, b] = tangents(&value.translation);
        // Derivatives of E with respect to the tangent components.
        let directions: [Matrix3<f64>; 5] = [
            t_hat * so3::hat(&Vector3::x()) * rotation,
            t_hat * so3::hat(&Vector3::y()) * rotation,
            t_hat * so3::hat(&Vector3::z()) * rotation,
            so3::hat(&a) * rotation,
            so3::hat(&b) * rotation,
        ];
        self.0.linearize(&essential, 1.0, &directions, normal);
    }
}
