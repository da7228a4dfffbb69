//! Absolute pose (PnP): the pose of a calibrated camera from 2D-3D correspondences.

use std::ops::Range;

use nalgebra::{Matrix2x3, Matrix3x4, SMatrix, SVector, Vector2, Vector3};
use tiepoint_simd::dispatch;

use crate::ransac::{Estimator, RansacOptions, Report, ransac};
use crate::simd::{LANES, Lanes, blocks_of, pack, store};
use crate::small_lm::{MAX_LM_ITERATIONS, NormalEquations, Problem, minimize};
use crate::{CameraModel, Intrinsics, Loss, Manifold, Rigid3, so3, solvers};

/// Estimates `cam_from_world` of a camera that observes `points_in_world[i]` at `pixels[i]`.
///
/// Minimal models come from P3P; refinement minimises the reprojection error. `options.max_error`
/// is a reprojection error in pixels. Points behind the camera are outliers.
pub fn absolute_pose(
    pixels: &[Vector2<f64>],
    points_in_world: &[Vector3<f64>],
    intrinsics: &Intrinsics,
    options: &RansacOptions,
) -> Option<Report<Rigid3>> {
    ransac(&AbsolutePose::new(pixels, points_in_world, intrinsics), options)
}

/// Refines `cam_from_world` by minimising the robust reprojection error, in pixels, from `initial`.
/// Points that do not project under `initial` are left out.
pub fn refine_absolute_pose(
    pixels: &[Vector2<f64>],
    points_in_world: &[Vector3<f64>],
    intrinsics: &Intrinsics,
    initial: &Rigid3,
    loss: Loss,
) -> Rigid3 {
    let projects = |i: &usize| intrinsics.project(&(*initial * points_in_world[*i])).is_some();
    let projecting: Vec<usize> =
        (0..pixels.len().min(points_in_world.len())).filter(projects).collect();
    let problem = Reprojection { pixels, points_in_world, intrinsics, inliers: &projecting };
    minimize(&problem, initial, loss, MAX_LM_ITERATIONS)
}

/// The RANSAC problem of the absolute pose.
pub(super) struct AbsolutePose<'a> {
    pub(super) pixels: &'a [Vector2<f64>],
    pub(super) points_in_world: &'a [Vector3<f64>],
    /// Unit rays of the pixels; zero for a pixel without a ray.
    rays: Vec<Vector3<f64>>,
    /// The correspondences, packed for SIMD.
    blocks: Vec<[Lanes; 5]>,
    pub(super) intrinsics: &'a Intrinsics,
}

impl<'a> AbsolutePose<'a> {
    pub(super) fn new(
        pixels: &'a [Vector2<f64>],
        points_in_world: &'a [Vector3<f64>],
        intrinsics: &'a Intrinsics,
    ) -> Self {
        let count = pixels.len().min(points_in_world.len());
        let (pixels, points_in_world) = (&pixels[..count], &points_in_world[..count]);
        let blocks = pack_observations(pixels, points_in_world);
        Self { pixels, points_in_world, rays: rays(pixels, intrinsics), blocks, intrinsics }
    }

    /// Squared reprojection errors in pixels, for any camera model.
    pub(super) fn squared_errors(
        &self,
        intrinsics: &Intrinsics,
        cam_from_world: &Rigid3,
        range: Range<usize>,
        squared: &mut [f64],
    ) {
        with_camera_model!(intrinsics, M, params => {
            squared_errors::<M>(&self.blocks, params, &cam_from_world.to_matrix(), range, squared);
        });
    }
}

/// The unit rays of pixels; zero for a pixel without a ray.
pub(super) fn rays(pixels: &[Vector2<f64>], intrinsics: &Intrinsics) -> Vec<Vector3<f64>> {
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
        self.squared_errors(self.intrinsics, model, range, squared);
    }

    fn refine(&self, model: &Rigid3, data: &[usize], loss: Loss) -> Option<Rigid3> {
        let Self { pixels, points_in_world, intrinsics, .. } = *self;
        let problem = Reprojection { pixels, points_in_world, intrinsics, inliers: data };
        Some(minimize(&problem, model, loss, MAX_LM_ITERATIONS))
    }
}

/// World points and pixels, packed for SIMD: X, Y, Z, u, v.
fn pack_observations(pixels: &[Vector2<f64>], points_in_world: &[Vector3<f64>]) -> Vec<[Lanes; 5]> {
    let observations: Vec<_> = points_in_world.iter().zip(pixels).collect();
    pack(&observations, |(point, pixel)| [point.x, point.y, point.z, pixel.x, pixel.y])
}

dispatch! {
    /// Squared reprojection errors, eight at a time; infinite for points that do not project.
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
                let pixel = Vector2::new(u[l], v[l]);
                if let Some(squared) = M::squared_error_px2(params, &point_in_cam, &pixel) {
                    lanes[l] = squared;
                }
            }
            store(&lanes, index, &range, squared);
        }
    }
}

/// Minimises the reprojection error over the pose.
struct Reprojection<'a> {
    pixels: &'a [Vector2<f64>],
    points_in_world: &'a [Vector3<f64>],
    intrinsics: &'a Intrinsics,
    inliers: &'a [usize],
}

/// d pixel / d (δ, τ) from d pixel / d point: the point in the camera moves by δ × X + τ.
pub(super) fn d_pose(d_point: &Matrix2x3<f64>, point_in_cam: &Vector3<f64>) -> SMatrix<f64, 2, 6> {
    let d_rotation = d_point * -so3::hat(point_in_cam);
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

    fn linearize(&self, value: &Rigid3, normal: &mut NormalEquations<6>) {
        let rotation = value.rotation.to_rotation_matrix();
        with_camera_model!(self.intrinsics, M, params => {
            for &i in self.inliers {
                let point_in_cam = rotation * self.points_in_world[i] + value.translation;
                match M::project_with_jacobian(params, &point_in_cam) {
                    Some(projection) => normal.add(
                        &M::displacement(params, &projection.pixel, &self.pixels[i]),
                        &d_pose(&projection.d_point, &point_in_cam),
                    ),
                    None => normal.reject(),
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CameraModelKind;
    use crate::testing::jacobian_law;

    /// Step of the numeric differentiation, in radians and metres.
    const STEP: f64 = 1e-3;

    #[test]
    fn d_pose_is_the_jacobian_by_the_tangent() {
        let pose =
            Rigid3::from_axis_angle(Vector3::new(0.2, -0.4, 1.0), Vector3::new(30.0, -2.0, 5.0));
        let point = pose.inverse() * Vector3::new(0.7, -0.4, 3.0);
        let intrinsics = Intrinsics::centred(CameraModelKind::Pinhole, 1.0, 2, 2);
        let analytic = with_camera_model!(&intrinsics, M, params => {
            let in_cam = pose * point;
            let projection = M::project_with_jacobian(params, &in_cam).expect("in front of the \
            camera");
            d_pose(&projection.d_point, &in_cam)
        });
        let pixel = |pose: &Rigid3| intrinsics.project(&(*pose * point));
        assert_eq!(jacobian_law(&pose, &analytic, STEP, pixel), Ok(()));
    }
}
