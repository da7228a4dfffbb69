//! Absolute pose with unknown focal length, from 2D-3D correspondences.

use std::ops::Range;

use nalgebra::{SMatrix, SVector, Vector2, Vector3};

use super::absolute_pose::{AbsolutePose, absolute_pose, d_pose, rays};
use crate::ransac::{Estimator, RansacOptions, Report, ransac};
use crate::small_lm::{MAX_LM_ITERATIONS, NormalEquations, Problem, minimize};
use crate::{CameraModel, Intrinsics, Loss, Manifold, Rigid3, solvers};

/// Focal lengths that [`absolute_pose_focal`] samples, as factors of the given focal lengths: a
/// geometric series from 0.3 to 3.33.
const FOCAL_FACTORS: [f64; 17] = [
    0.300, 0.349, 0.406, 0.472, 0.548, 0.637, 0.741, 0.862, 1.0, 1.16, 1.35, 1.57, 1.83, 2.12,
    2.47, 2.87, 3.33,
];

/// Estimates `cam_from_world` and a common factor of the focal lengths, as
/// [`absolute_pose`](super::absolute_pose()) does for known focal lengths.
///
/// Each sample has four points. P3P on the first three is solved at 17 focal lengths, from 0.3 to
/// 3.33 times those of `intrinsics`. The pose and focal length of the smallest reprojection error
/// of the fourth point is refined over the four points. All refinements optimise the pose and the
/// focal length together. The returned intrinsics are the given ones with scaled focal lengths. A
/// model without focal lengths is calibrated: its pose is that of
/// [`absolute_pose`](super::absolute_pose()).
pub fn absolute_pose_focal(
    pixels: &[Vector2<f64>],
    points_in_world: &[Vector3<f64>],
    intrinsics: &Intrinsics,
    options: &RansacOptions,
) -> Option<Report<(Rigid3, Intrinsics)>> {
    if intrinsics.kind().focal_indices().is_empty() {
        let report = absolute_pose(pixels, points_in_world, intrinsics, options)?;
        return Some(report.map(|pose| (pose, *intrinsics)));
    }
    let candidates = FOCAL_FACTORS
        .map(|factor| {
            let camera = with_focal_factor(intrinsics, factor);
            FocalCandidate { rays: rays(pixels, &camera), factor, camera }
        })
        .into();
    let data = AbsolutePose::new(pixels, points_in_world, intrinsics);
    let report = ransac(&AbsolutePoseFocal { data, candidates }, options)?;
    Some(report.map(|(pose, log_factor)| (pose, with_focal_factor(intrinsics, log_factor.exp()))))
}

/// The intrinsics with all focal lengths multiplied by a factor.
fn with_focal_factor(intrinsics: &Intrinsics, factor: f64) -> Intrinsics {
    let mut scaled = *intrinsics;
    for &index in intrinsics.kind().focal_indices() {
        scaled.params_mut()[index] *= factor;
    }
    scaled
}

/// A sampled focal length, with the unit rays of all pixels.
struct FocalCandidate {
    factor: f64,
    camera: Intrinsics,
    rays: Vec<Vector3<f64>>,
}

/// The RANSAC problem of the absolute pose with unknown focal length.
struct AbsolutePoseFocal<'a> {
    data: AbsolutePose<'a>,
    candidates: Vec<FocalCandidate>,
}

impl Estimator for AbsolutePoseFocal<'_> {
    /// Pose and logarithm of the focal length factor.
    type Model = (Rigid3, f64);
    const SAMPLE_SIZE: usize = 4;

    fn num_data(&self) -> usize {
        self.data.num_data()
    }

    fn models(&self, sample: &[usize], models: &mut Vec<Self::Model>) {
        let points: [Vector3<f64>; 3] =
            std::array::from_fn(|i| self.data.points_in_world[sample[i]]);
        let (pixel, point) = (self.data.pixels[sample[3]], self.data.points_in_world[sample[3]]);
        let mut best: Option<(f64, Self::Model)> = None;
        for FocalCandidate { factor, camera, rays } in &self.candidates {
            let rays: [Vector3<f64>; 3] = std::array::from_fn(|i| rays[sample[i]]);
            for pose in solvers::p3p(&rays, &points) {
                let Some(error) = camera.squared_error_px2(&(pose * point), &pixel) else {
                    continue;
                };
                if best.as_ref().is_none_or(|(least, _)| error < *least) {
                    best = Some((error, (pose, factor.ln())));
                }
            }
        }
        // Four points determine the focal length, which lies between two of the sampled ones.
        if let Some((_, model)) = best {
            models.extend(self.refine(&model, sample, Loss::Trivial));
        }
    }

    fn squared_residuals(
        &self,
        (pose, log_factor): &Self::Model,
        range: Range<usize>,
        squared: &mut [f64],
    ) {
        let camera = with_focal_factor(self.data.intrinsics, log_factor.exp());
        self.data.squared_errors(&camera, pose, range, squared);
    }

    fn refine(&self, model: &Self::Model, data: &[usize], loss: Loss) -> Option<Self::Model> {
        let problem = ReprojectionFocal { data: &self.data, inliers: data };
        Some(minimize(&problem, model, loss, MAX_LM_ITERATIONS))
    }
}

/// Minimises the reprojection error over the pose and the focal length factor.
struct ReprojectionFocal<'a> {
    data: &'a AbsolutePose<'a>,
    inliers: &'a [usize],
}

impl Problem<7> for ReprojectionFocal<'_> {
    type Value = (Rigid3, f64);

    fn plus(&self, (pose, log_factor): &Self::Value, delta: &SVector<f64, 7>) -> Self::Value {
        (pose.plus(&delta.fixed_rows::<6>(0).into_owned()), log_factor + delta[6])
    }

    fn linearize(&self, (pose, log_factor): &Self::Value, normal: &mut NormalEquations<7>) {
        let camera = with_focal_factor(self.data.intrinsics, log_factor.exp());
        let centre = camera.principal_point();
        let rotation = pose.rotation.to_rotation_matrix();
        with_camera_model!(&camera, M, params => {
            for &i in self.inliers {
                let point_in_cam = rotation * self.data.points_in_world[i] + pose.translation;
                let Some(projection) = M::project_with_jacobian(params, &point_in_cam) else {
                    normal.reject();
                    continue;
                };
                // In every model pixel − c is proportional to f, so that it is the derivative by
                // ln f.
                let d_log_factor = projection.pixel - centre;
                let mut jacobian = SMatrix::<f64, 2, 7>::zeros();
                let by_pose = d_pose(&projection.d_point, &point_in_cam);
                jacobian.fixed_columns_mut::<6>(0).copy_from(&by_pose);
                jacobian.set_column(6, &d_log_factor);
                normal.add(&(projection.pixel - self.data.pixels[i]), &jacobian);
            }
        });
    }
}
