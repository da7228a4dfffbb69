//! The pose and the focal length of a camera from points seen in it.

use std::ops::Range;

use nalgebra::{SMatrix, SVector, Vector2, Vector3};

use super::absolute_pose::{AbsolutePose, d_pose, rays};
use crate::ransac::{Estimator, RansacOptions, Report, ransac};
use crate::small_lm::{MAX_LM_ITERATIONS, Normal, Problem, minimize};
use crate::{CameraModel, Intrinsics, Loss, Manifold, Rigid3, solvers};

/// Focal lengths that [`absolute_pose_focal`] tries, as factors of the given one: a geometric
/// series that covers fields of view from a third to three times as wide.
const FOCAL_FACTORS: [f64; 17] = [
    0.300, 0.349, 0.406, 0.472, 0.548, 0.637, 0.741, 0.862, 1.0, 1.16, 1.35, 1.57, 1.83, 2.12,
    2.47, 2.87, 3.33,
];

/// Like [`absolute_pose`](super::absolute_pose()), for a camera whose focal lengths are known but
/// for a common factor: each sample of four is solved by P3P at a series of focal lengths, from 0.3
/// to 3.3 times the given ones, that of the least error at the fourth point being kept; refinement
/// moves the focal length with the pose. The model's intrinsics differ from the given ones in that
/// factor.
pub fn absolute_pose_focal(
    pixels: &[Vector2<f64>],
    points_in_world: &[Vector3<f64>],
    intrinsics: &Intrinsics,
    options: &RansacOptions,
) -> Option<Report<(Rigid3, Intrinsics)>> {
    let cameras = FOCAL_FACTORS
        .map(|factor| {
            let camera = with_focal_factor(intrinsics, factor);
            AbsolutePoseRays { rays: rays(pixels, &camera), factor, camera }
        })
        .into();
    let data = AbsolutePose::new(pixels, points_in_world, intrinsics);
    let report = ransac(&AbsolutePoseFocal { data, cameras }, options)?;
    Some(report.map(|(pose, log_factor)| (pose, with_focal_factor(intrinsics, log_factor.exp()))))
}

fn with_focal_factor(intrinsics: &Intrinsics, factor: f64) -> Intrinsics {
    let mut scaled = *intrinsics;
    for &index in intrinsics.kind().focal_indices() {
        scaled.params_mut()[index] *= factor;
    }
    scaled
}

struct AbsolutePoseRays {
    factor: f64,
    camera: Intrinsics,
    rays: Vec<Vector3<f64>>,
}

struct AbsolutePoseFocal<'a> {
    data: AbsolutePose<'a>,
    cameras: Vec<AbsolutePoseRays>,
}

impl Estimator for AbsolutePoseFocal<'_> {
    /// Pose and logarithm of the factor.
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
        for AbsolutePoseRays { factor, camera, rays } in &self.cameras {
            let rays: [Vector3<f64>; 3] = std::array::from_fn(|i| rays[sample[i]]);
            for pose in solvers::p3p(&rays, &points) {
                let Some(projected) = camera.project(&(pose * point)) else { continue };
                let error = (projected - pixel).norm_squared();
                if best.as_ref().is_none_or(|(least, _)| error < *least) {
                    best = Some((error, (pose, factor.ln())));
                }
            }
        }
        // Between two of the focal lengths tried: the four points determine the best.
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

struct ReprojectionFocal<'a> {
    data: &'a AbsolutePose<'a>,
    inliers: &'a [usize],
}

impl Problem<7> for ReprojectionFocal<'_> {
    type Value = (Rigid3, f64);

    fn plus(&self, (pose, log_factor): &Self::Value, delta: &SVector<f64, 7>) -> Self::Value {
        (pose.plus(&delta.fixed_rows::<6>(0).into_owned()), log_factor + delta[6])
    }

    fn linearize(&self, (pose, log_factor): &Self::Value, normal: &mut Normal<7>) {
        let camera = with_focal_factor(self.data.intrinsics, log_factor.exp());
        let centre = camera.principal_point();
        let rotation = pose.rotation.to_rotation_matrix();
        with_camera_model!(&camera, M, params => {
            for &i in self.inliers {
                let point_in_cam = rotation * self.data.points_in_world[i] + pose.translation;
                let Some(projection) = M::project_with_jacobian(params, &point_in_cam) else {
                    normal.refuse();
                    continue;
                };
                // Every model is c + f · (something), so that the offset from c is the derivative
                // by ln f.
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
