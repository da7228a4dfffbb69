//! Control points: points with measured coordinates that are marked in images.

use tiepoint_geometry::nalgebra::{Matrix3, Vector2, Vector3};
use tiepoint_geometry::triangulate::{ViewRay, triangulate};
use tiepoint_geometry::{Rigid3, Sim3};
use tiepoint_scene::{ImageId, Reconstruction};

use super::redundancy::Verdict;
use crate::rolling_shutter::{RollingShutter, row_poses};

/// Largest distance of a mark from its point in the image, in deviations, and the least deviation
/// that counts there, in pixels: the model has errors, too.
const MAX_MARK_SIGMAS: f64 = 4.0;
const MIN_MARK_PX: f64 = 1.0;
/// Least angle between two rays to a point (1.5°).
const MIN_ANGLE_RAD: f64 = 0.026;

/// A point with measured coordinates that is marked in images.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkedPoint {
    /// Its measured coordinates, in a metric frame.
    pub xyz: Vector3<f64>,
    /// Their standard deviations along the axes, in metres.
    pub sigmas_m: Vector3<f64>,
    /// Whether it only tells of errors.
    pub is_check: bool,
    /// Standard deviation of the coordinates of a mark, in pixels.
    pub mark_sigma_px: f64,
    /// The images in which it is marked, with the pixels.
    pub marks: Vec<(ImageId, Vector2<f64>)>,
}

/// A point after the alignment.
#[derive(Clone, Debug, PartialEq)]
pub struct PointError {
    /// Number of marks in images with a pose.
    pub num_marks: usize,
    /// Images with a pose whose marks do not agree with the others.
    pub wrong_marks: Vec<ImageId>,
    /// Root mean square distance of the other marks from the projections of the point, in pixels;
    /// `None` if the marks do not determine it.
    pub rms_px: Option<f64>,
    /// Its place in the model minus the measured one, in metres; `None` if the marks do not
    /// determine it.
    pub error_m: Option<Vector3<f64>>,
    /// Standard deviations of this error along the axes, in metres, without errors of the model.
    pub sigmas_m: Vector3<f64>,
    /// Whether the others contradict it, and no other point explains that; it is not used.
    pub is_wrong: bool,
    /// If the others contradict it and it is not used, though one of these points may be wrong in
    /// its place, their indices.
    pub alternatives: Vec<usize>,
    /// Sizes of errors of its measured coordinates along the axes that are detected in 80 % of
    /// cases, in metres; infinite where nothing tests them. `None` without a test.
    pub detectable_m: Option<Vector3<f64>>,
    /// As `detectable_m`, of errors that no other point explains, so that it is known as wrong.
    pub separable_m: Option<Vector3<f64>>,
}

impl PointError {
    /// Takes what the test of `tested` points tells about this one.
    pub(super) fn set_verdict(&mut self, verdict: Verdict, tested: &[usize]) {
        self.is_wrong = verdict.is_wrong;
        self.alternatives = verdict.alternatives.iter().map(|&k| tested[k]).collect();
        self.detectable_m = Some(verdict.detectable_m);
        self.separable_m = Some(verdict.separable_m);
    }
}

/// A point that its marks determine in the model, with the covariance of its marks.
pub(super) struct Found {
    pub(super) xyz: Vector3<f64>,
    covariance: Matrix3<f64>,
    /// Indices of the marks that agree.
    pub(super) inliers: Vec<usize>,
    rms_px: f64,
}

/// The points with their marks where a global shutter would show them, for a model whose cameras
/// have rolling shutters and whose keypoints are corrected for them.
pub fn with_global_shutter(
    model: &Reconstruction,
    shutters: &[RollingShutter],
    points: &[MarkedPoint],
) -> Vec<MarkedPoint> {
    let rows = row_poses(model, shutters);
    let pose_of_row = |(image, pixel): &(ImageId, Vector2<f64>)| {
        let middle = model.image(*image).cam_from_world()?;
        Some(rows.get(image).map_or(*middle, |rows| rows.cam_from_world(middle, pixel.y)))
    };
    let shifted = |point: &MarkedPoint| {
        let poses: Vec<Option<Rigid3>> = point.marks.iter().map(pose_of_row).collect();
        let ray = |((image, pixel), pose): (&(ImageId, Vector2<f64>), &'_ Option<Rigid3>)| {
            Some((*image, *pixel, (*pose)?))
        };
        let posed: Vec<(ImageId, Vector2<f64>, Rigid3)> =
            point.marks.iter().zip(&poses).filter_map(ray).collect();
        let rays: Vec<ViewRay> = posed
            .iter()
            .filter_map(|(image, pixel, pose)| {
                ViewRay::new(pose, &model.camera_of(*image).intrinsics, *pixel)
            })
            .collect();
        let found = triangulate(&rays, max_error_px(point), MIN_ANGLE_RAD);
        let shift = |(image, pose): (ImageId, &Option<Rigid3>)| {
            let (xyz, intrinsics) = (found.as_ref()?.xyz, &model.camera_of(image).intrinsics);
            let still = intrinsics.project(&(*model.image(image).cam_from_world()? * xyz))?;
            Some(intrinsics.displacement(&intrinsics.project(&((*pose)? * xyz))?, &still))
        };
        let marks = point.marks.iter().zip(&poses).map(|((image, pixel), pose)| {
            (*image, pixel - shift((*image, pose)).unwrap_or_default())
        });
        MarkedPoint { marks: marks.collect(), ..point.clone() }
    };
    match rows.is_empty() {
        true => points.to_vec(),
        false => points.iter().map(shifted).collect(),
    }
}

/// Largest distance of a mark from its point, in pixels.
fn max_error_px(point: &MarkedPoint) -> f64 {
    MAX_MARK_SIGMAS * point.mark_sigma_px.max(MIN_MARK_PX)
}

/// The places of points in a model; `None` where the marks do not determine one.
pub(super) fn places(model: &Reconstruction, points: &[MarkedPoint]) -> Vec<Option<Found>> {
    points.iter().map(|point| in_model(model, point)).collect()
}

/// The errors of points in a model in their frame.
pub fn point_errors(model: &Reconstruction, points: &[MarkedPoint]) -> Vec<PointError> {
    let found = places(model, points);
    errors(model, points, &found, &Sim3::identity(), &|_| true)
}

/// The errors of points after a similarity; `is_used` of their indices tells which took part.
pub(super) fn errors(
    model: &Reconstruction,
    points: &[MarkedPoint],
    found: &[Option<Found>],
    similarity: &Sim3,
    is_used: &dyn Fn(usize) -> bool,
) -> Vec<PointError> {
    let of_point = |(k, point): (usize, &MarkedPoint)| {
        let found = found[k].as_ref();
        let posed = point.marks.iter().enumerate().filter(|(_, mark)| has_pose(model, mark.0));
        let disagrees = |index: usize| found.is_some_and(|found| !found.inliers.contains(&index));
        let wrong = posed.clone().filter(|(index, _)| disagrees(*index));
        PointError {
            num_marks: posed.clone().count(),
            wrong_marks: wrong.map(|(_, mark)| mark.0).collect(),
            rms_px: found.map(|found| found.rms_px),
            error_m: found.map(|found| *similarity * found.xyz - point.xyz),
            sigmas_m: found
                .map_or(Vector3::repeat(f64::INFINITY), |found| sigmas(point, found, similarity)),
            is_wrong: found.is_some() && !point.is_check && !is_used(k),
            alternatives: Vec::new(),
            detectable_m: None,
            separable_m: None,
        }
    };
    points.iter().enumerate().map(of_point).collect()
}

fn has_pose(model: &Reconstruction, image: ImageId) -> bool {
    model.image(image).cam_from_world().is_some()
}

fn in_model(model: &Reconstruction, point: &MarkedPoint) -> Option<Found> {
    let of_mark = |(index, (image, pixel)): (usize, &(ImageId, Vector2<f64>))| {
        let pose = model.image(*image).cam_from_world()?;
        let intrinsics = &model.camera_of(*image).intrinsics;
        Some((index, ViewRay::new(pose, intrinsics, *pixel)?))
    };
    let (marks, rays): (Vec<usize>, Vec<ViewRay>) =
        point.marks.iter().enumerate().filter_map(of_mark).unzip();
    let first = triangulate(&rays, max_error_px(point), MIN_ANGLE_RAD)?;
    let inliers: Vec<usize> = first.inliers.iter().map(|&k| marks[k]).collect();
    let (xyz, covariance) = nearest(model, point, &inliers, first.xyz)?;
    let squared_px2 = |&k: &usize| {
        let (image, pixel) = point.marks[k];
        let in_camera = *model.image(image).cam_from_world()? * xyz;
        model.camera_of(image).intrinsics.squared_error_px2(&in_camera, &pixel)
    };
    let sum_px2 = inliers.iter().map(squared_px2).sum::<Option<f64>>()?;
    Some(Found { xyz, covariance, rms_px: (sum_px2 / inliers.len() as f64).sqrt(), inliers })
}

/// The point nearest to the rays of some marks, whose deviations grow with their distances, and its
/// covariance.
fn nearest(
    model: &Reconstruction,
    point: &MarkedPoint,
    marks: &[usize],
    mut xyz: Vector3<f64>,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let mut covariance = Matrix3::zeros();
    // The distances of the second round are right to the second order.
    for _ in 0..2 {
        let (mut information, mut sum) = (Matrix3::zeros(), Vector3::zeros());
        for &(image, pixel) in marks.iter().map(|&k| &point.marks[k]) {
            let pose = model.image(image).cam_from_world()?;
            let intrinsics = &model.camera_of(image).intrinsics;
            let direction = pose.rotation.inverse() * intrinsics.unproject(&pixel)?.normalize();
            let centre = pose.origin_in_a();
            let sigma = point.mark_sigma_px / intrinsics.mean_focal_px() * (xyz - centre).norm();
            let across = Matrix3::identity() - direction * direction.transpose();
            information += across / sigma.powi(2);
            sum += across * centre / sigma.powi(2);
        }
        covariance = information.try_inverse()?;
        xyz = covariance * sum;
    }
    Some((xyz, covariance))
}

/// Deviations of the error of a point in the measured frame.
pub(super) fn sigmas(point: &MarkedPoint, found: &Found, similarity: &Sim3) -> Vector3<f64> {
    let rotation = similarity.rotation.to_rotation_matrix();
    let covariance = rotation * found.covariance * rotation.inverse();
    let variances = covariance.diagonal() * similarity.scale.powi(2);
    variances.zip_map(&point.sigmas_m, |variance, sigma_m| (variance + sigma_m.powi(2)).sqrt())
}
