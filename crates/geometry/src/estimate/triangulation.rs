//! Triangulation of a point from observations with outliers.

use std::ops::Range;

use nalgebra::{SVector, Vector2, Vector3};

use crate::ransac::{Estimator, RansacOptions, Report, ransac};
use crate::small_lm::{MAX_LM_ITERATIONS, NormalEquations, Problem, minimize};
use crate::triangulate::{triangulate_two_view, triangulation_angle};
use crate::{CameraModel, Intrinsics, Loss, Rigid3};

/// An observation of a point: a pixel in a camera of known pose.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// Pose of the camera.
    pub cam_from_world: &'a Rigid3,
    /// Intrinsics of the camera.
    pub intrinsics: &'a Intrinsics,
    /// The observed pixel.
    pub pixel: Vector2<f64>,
}

/// The residual of [`triangulation`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TriangulationResidual {
    /// The angle between the ray of the pixel and that to the point, in radians.
    Angle,
    /// The reprojection error, in pixels.
    Pixel,
}

/// Options of [`triangulation`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TriangulationOptions {
    /// Minimum triangulation angle: at least two inliers must reach it.
    pub min_angle_rad: f64,
    /// The residual that is compared with `ransac.max_error`, in its unit.
    pub residual: TriangulationResidual,
    /// Samples are pairs of observations. All pairs are tried if there are at most
    /// `min_iterations`.
    pub ransac: RansacOptions,
}

impl Default for TriangulationOptions {
    /// Reprojection error, minimum angle of 1.5 degrees.
    fn default() -> Self {
        Self {
            min_angle_rad: 1.5_f64.to_radians(),
            residual: TriangulationResidual::Pixel,
            ransac: RansacOptions::default(),
        }
    }
}

/// Estimates the world point of the observations. It is in front of the cameras of its inliers, and
/// at least two of them reach the minimum triangulation angle.
pub fn triangulation(
    observations: &[Observation<'_>],
    options: &TriangulationOptions,
) -> Option<Report<Vector3<f64>>> {
    let centres = observations.iter().map(|o| o.cam_from_world.origin_in_a()).collect();
    let rays = observations.iter().map(|o| o.intrinsics.unproject(&o.pixel)).collect();
    let estimator = Triangulation { observations, centres, rays, options };
    let report = ransac(&estimator, &options.ransac)?;
    let inliers: Vec<usize> = (0..observations.len()).filter(|&i| report.inliers[i]).collect();
    estimator.has_min_angle(&report.model, &inliers).then_some(report)
}

/// The RANSAC problem of triangulation.
struct Triangulation<'a> {
    observations: &'a [Observation<'a>],
    centres: Vec<Vector3<f64>>,
    rays: Vec<Option<Vector3<f64>>>,
    options: &'a TriangulationOptions,
}

impl Triangulation<'_> {
    /// Whether two of the observations reach the minimum triangulation angle.
    fn has_min_angle(&self, point: &Vector3<f64>, indices: &[usize]) -> bool {
        indices.iter().enumerate().any(|(k, &i)| {
            indices[..k].iter().any(|&j| {
                triangulation_angle(&self.centres[i], &self.centres[j], point)
                    >= self.options.min_angle_rad
            })
        })
    }
}

impl Estimator for Triangulation<'_> {
    type Model = Vector3<f64>;
    const SAMPLE_SIZE: usize = 2;

    fn num_data(&self) -> usize {
        self.observations.len()
    }

    fn models(&self, sample: &[usize], models: &mut Vec<Vector3<f64>>) {
        let (Some(ray1), Some(ray2)) = (self.rays[sample[0]], self.rays[sample[1]]) else { return };
        let world_from_cam1 = self.observations[sample[0]].cam_from_world.inverse();
        let cam2_from_cam1 = *self.observations[sample[1]].cam_from_world * world_from_cam1;
        let point = triangulate_two_view(&ray1, &ray2, &cam2_from_cam1)
            .map(|point| world_from_cam1 * point);
        models.extend(point.filter(|point| self.has_min_angle(point, sample)));
    }

    fn squared_residuals(&self, point: &Vector3<f64>, range: Range<usize>, squared: &mut [f64]) {
        for (squared, i) in squared.iter_mut().zip(range) {
            let observation = &self.observations[i];
            let point_in_cam = *observation.cam_from_world * *point;
            let error2 = match self.options.residual {
                TriangulationResidual::Angle => self.rays[i].map(|ray| {
                    ray.cross(&point_in_cam).norm().atan2(ray.dot(&point_in_cam)).powi(2)
                }),
                TriangulationResidual::Pixel => {
                    observation.intrinsics.squared_error_px2(&point_in_cam, &observation.pixel)
                }
            };
            *squared = error2.unwrap_or(f64::INFINITY);
        }
    }

    fn refine(&self, point: &Vector3<f64>, data: &[usize], loss: Loss) -> Option<Vector3<f64>> {
        let problem = PointReprojection { data: self, inliers: data };
        Some(minimize(&problem, point, loss, MAX_LM_ITERATIONS))
    }
}

/// Minimises the reprojection error over the point, because noise is in pixels. For angular
/// residuals the error is divided by the focal length, which gives radians.
struct PointReprojection<'a> {
    data: &'a Triangulation<'a>,
    inliers: &'a [usize],
}

impl Problem<3> for PointReprojection<'_> {
    type Value = Vector3<f64>;

    fn plus(&self, value: &Vector3<f64>, delta: &SVector<f64, 3>) -> Vector3<f64> {
        value + delta
    }

    fn linearize(&self, value: &Vector3<f64>, normal: &mut NormalEquations<3>) {
        for &i in self.inliers {
            let Observation { cam_from_world, intrinsics, pixel } = self.data.observations[i];
            let rotation = cam_from_world.rotation.to_rotation_matrix();
            let point_in_cam = rotation * value + cam_from_world.translation;
            let unit_per_px = match self.data.options.residual {
                TriangulationResidual::Angle => 1.0 / intrinsics.mean_focal_px(),
                TriangulationResidual::Pixel => 1.0,
            };
            with_camera_model!(intrinsics, M, params => {
                match M::project_with_jacobian(params, &point_in_cam) {
                    Some(p) => {
                        let d_point = p.d_point * rotation.matrix() * unit_per_px;
                        let error_px = M::displacement(params, &p.pixel, &pixel);
                        normal.add(&(error_px * unit_per_px), &d_point);
                    }
                    None => normal.reject(),
                }
            });
        }
    }
}
