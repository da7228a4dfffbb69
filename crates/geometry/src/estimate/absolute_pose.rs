//! The pose of a camera from points seen in it.

use std::ops::Range;

use nalgebra::{Matrix2x3, Matrix3x4, SMatrix, SVector, Vector2, Vector3};

use super::MAX_LM_ITERATIONS;
use crate::ransac::{Estimator, RansacOptions, Report, ransac};
use crate::simd::{LANES, Lanes, blocks_of, pack, store};
use crate::small_lm::{Normal, Problem, minimize};
use crate::{CameraModel, Intrinsics, Loss, Manifold, Rigid3, so3, solvers};

/// `cam_from_world` of a camera that sees `points_in_world[i]` at `pixels[i]`; P3P on samples, then least reprojection error of
/// the inliers. Errors are in pixels; points behind the camera are outliers.
pub fn absolute_pose(
    pixels: &[Vector2<f64>],
    points_in_world: &[Vector3<f64>],
    intrinsics: &Intrinsics,
    options: &RansacOptions,
) -> Option<Report<Rigid3>> {
    ransac(&AbsolutePose::new(pixels, points_in_world, intrinsics), options)
}

/// The pose of least robust reprojection error near `initial`. Points that `initial` has behind the camera are left out.
pub fn refine_absolute_pose(
    pixels: &[Vector2<f64>],
    points_in_world: &[Vector3<f64>],
    intrinsics: &Intrinsics,
    initial: &Rigid3,
    loss: Loss,
) -> Rigid3 {
    let is_seen = |i: &usize| intrinsics.project(&(*initial * points_in_world[*i])).is_some();
    let seen: Vec<usize> = (0..pixels.len().min(points_in_world.len())).filter(is_seen).collect();
    let problem = Reprojection { pixels, points_in_world, intrinsics, inliers: &seen };
    minimize(&problem, initial, loss, MAX_LM_ITERATIONS)
}

struct AbsolutePose<'a> {
    pixels: &'a [Vector2<f64>],
    points_in_world: &'a [Vector3<f64>],
    /// Zero where the pixel has no ray.
    rays: Vec<Vector3<f64>>,
    blocks: Vec<[Lanes; 5]>,
    intrinsics: &'a Intrinsics,
}

impl<'a> AbsolutePose<'a> {
    fn new(
        pixels: &'a [Vector2<f64>],
        points_in_world: &'a [Vector3<f64>],
        intrinsics: &'a Intrinsics,
    ) -> Self {
        let count = pixels.len().min(points_in_world.len());
        let (pixels, points_in_world) = (&pixels[..count], &points_in_world[..count]);
        let blocks = pack_observations(pixels, points_in_world);
        Self { pixels, points_in_world, rays: rays(pixels, intrinsics), blocks, intrinsics }
    }
}

/// The unit rays of pixels; zero where there is none.
fn rays(pixels: &[Vector2<f64>], intrinsics: &Intrinsics) -> Vec<Vector3<f64>> {
    pixels.iter().map(|pixel| intrinsics.unproject(pixel).unwrap_or_default()).collect()
}

impl Estimator for AbsolutePose<'_> {
    type Model = Rigid3;
    const SAMPLE_SIZE: usize = 3;

    fn num_data(&self) -> usize {
        self.pixels.len()
    }

    fn models(&self, sample: &[usize], models: &mut Vec<Rigid3>) {
        let rays: [Vector3<f64>; 3] = std::array::from_fn(|i| self.rays[sample[i]]);
        let points: [Vector3<f64>; 3] = std::array::from_fn(|i| self.points_in_world[sample[i]]);
        models.extend(solvers::p3p(&rays, &points));
    }

    fn squared_residuals(&self, model: &Rigid3, range: Range<usize>, squared: &mut [f64]) {
        with_camera_model!(self.intrinsics, M, params => {
            squared_errors::<M>(&self.blocks, params, &model.to_matrix(), range, squared);
        });
    }

    fn refine(&self, model: &Rigid3, data: &[usize], loss: Loss) -> Option<Rigid3> {
        let Self { pixels, points_in_world, intrinsics, .. } = *self;
        let problem = Reprojection { pixels, points_in_world, intrinsics, inliers: data };
        Some(minimize(&problem, model, loss, MAX_LM_ITERATIONS))
    }
}

/// World points and pixels, packed for vectors: X, Y, Z, u, v.
fn pack_observations(pixels: &[Vector2<f64>], points_in_world: &[Vector3<f64>]) -> Vec<[Lanes; 5]> {
    let observations: Vec<_> = points_in_world.iter().zip(pixels).collect();
    pack(&observations, |(point, pixel)| [point.x, point.y, point.z, pixel.x, pixel.y])
}

dispatch! {
    /// Squared distances of the projections from the pixels, eight at a time.
    fn squared_errors<M: CameraModel>(
        blocks: &[[Lanes; 5]],
        params: &M::Params,
        cam_from_world: &Matrix3x4<f64>,
        range: Range<usize>,
        squared: &mut [f64],
    ) {
        let m = cam_from_world;
        for index in blocks_of(&range) {
            let [x, y, z, u, v] = &blocks[index];
            let mut lanes = [f64::INFINITY; LANES];
            for l in 0..LANES {
                let point_in_cam = Vector3::new(
                    m.m11 * x[l] + m.m12 * y[l] + m.m13 * z[l] + m.m14,
                    m.m21 * x[l] + m.m22 * y[l] + m.m23 * z[l] + m.m24,
                    m.m31 * x[l] + m.m32 * y[l] + m.m33 * z[l] + m.m34,
                );
                if let Some(pixel) = M::project(params, &point_in_cam) {
                    let (du, dv) = (pixel.x - u[l], pixel.y - v[l]);
                    lanes[l] = du * du + dv * dv;
                }
            }
            store(&lanes, index, &range, squared);
        }
    }
}

struct Reprojection<'a> {
    pixels: &'a [Vector2<f64>],
    points_in_world: &'a [Vector3<f64>],
    intrinsics: &'a Intrinsics,
    inliers: &'a [usize],
}

/// d pixel / d (rotation, translation), the rotation perturbed on the left: X ↦ X + δ × (X − t).
fn d_pose(d_point: &Matrix2x3<f64>, rotated: &Vector3<f64>) -> SMatrix<f64, 2, 6> {
    let d_rotation = d_point * -so3::hat(rotated);
    let mut jacobian = SMatrix::<f64, 2, 6>::zeros();
    jacobian.fixed_columns_mut::<3>(0).copy_from(&d_rotation);
    jacobian.fixed_columns_mut::<3>(3).copy_from(d_point);
    jacobian
}

impl Problem<6> for Reprojection<'_> {
    type Value = Rigid3;

    fn plus(&self, value: &Rigid3, delta: &SVector<f64, 6>) -> Rigid3 {
        value.plus(delta)
    }

    fn linearize(&self, value: &Rigid3, normal: &mut Normal<6>) {
        let rotation = value.rotation.to_rotation_matrix();
        with_camera_model!(self.intrinsics, M, params => {
            for &i in self.inliers {
                let rotated = rotation * self.points_in_world[i];
                match M::project_with_jacobian(params, &(rotated + value.translation)) {
                    Some(projection) => normal.add(
                        &(projection.pixel - self.pixels[i]),
                        &d_pose(&projection.d_point, &rotated),
                    ),
                    None => normal.refuse(),
                }
            }
        });
    }
}

/// Focal lengths that [`absolute_pose_focal`] tries, as factors of the given one: a geometric series that covers fields of view
/// from a third to three times as wide.
const FOCAL_FACTORS: [f64; 17] = [
    0.300, 0.349, 0.406, 0.472, 0.548, 0.637, 0.741, 0.862, 1.0, 1.16, 1.35, 1.57, 1.83, 2.12, 2.47, 2.87,
    3.33,
];

/// Like [`absolute_pose`], for a camera whose focal lengths are known but for a common factor: each sample of four is solved by
/// P3P at a series of focal lengths, from 0.3 to 3.3 times the given ones, that of the least error at the fourth point being
/// kept; refinement moves the focal length with the pose. The model's intrinsics differ from the given ones in that factor.
pub fn absolute_pose_focal(
    pixels: &[Vector2<f64>],
    points_in_world: &[Vector3<f64>],
    intrinsics: &Intrinsics,
    options: &RansacOptions,
) -> Option<Report<(Rigid3, Intrinsics)>> {
    let cameras = FOCAL_FACTORS
        .map(|factor| {
            let camera = with_focal_factor(intrinsics, factor);
            AbsolutePoseRays {
                rays: AbsolutePose::new(pixels, points_in_world, &camera).rays,
                factor,
                camera,
            }
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
        let points: [Vector3<f64>; 3] = std::array::from_fn(|i| self.data.points_in_world[sample[i]]);
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

    fn squared_residuals(&self, (pose, log_factor): &Self::Model, range: Range<usize>, squared: &mut [f64]) {
        let camera = with_focal_factor(self.data.intrinsics, log_factor.exp());
        with_camera_model!(&camera, M, params => {
            squared_errors::<M>(&self.data.blocks, params, &pose.to_matrix(), range, squared);
        });
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
                let rotated = rotation * self.data.points_in_world[i];
                let Some(projection) = M::project_with_jacobian(params, &(rotated + pose.translation)) else {
                    normal.refuse();
                    continue;
                };
                // Every model is c + f · (something), so that the offset from c is the derivative by ln f.
                let d_log_factor = projection.pixel - centre;
                let mut jacobian = SMatrix::<f64, 2, 7>::zeros();
                jacobian.fixed_columns_mut::<6>(0).copy_from(&d_pose(&projection.d_point, &rotated));
                jacobian.set_column(6, &d_log_factor);
                normal.add(&(projection.pixel - self.data.pixels[i]), &jacobian);
            }
        });
    }
}
