//! Control points: points with measured coordinates that are marked in images.

use tiepoint_geometry::nalgebra::{Matrix3, SVector, Vector2, Vector3};
use tiepoint_geometry::triangulate::{ViewRay, triangulate};
use tiepoint_geometry::{Sim3, solvers};
use tiepoint_scene::{ImageId, Reconstruction};

use super::alignment::{Free, Pair, axes_of, is_upside_down, refined};

/// Largest distance of a mark from its point in the image: four deviations of marks by hand.
const MAX_MARK_PX: f64 = 12.0;
/// Standard deviation of a mark by hand.
const MARK_PX: f64 = 3.0;
/// Least angle between two rays to a point (1.5°).
const MIN_ANGLE_RAD: f64 = 0.026;
/// Fewest points: three determine a similarity.
const MIN_POINTS: usize = 3;
/// Largest standard deviation of a rotation (3°), and of the logarithm of the scale, that is of
/// use: as far from the points as they are from each other, an error of a twentieth of that.
const MAX_SD: f64 = 0.05;
/// Normal quantile of one in a thousand.
const QUANTILE: f64 = 3.09;

/// A point with measured coordinates that is marked in images.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkedPoint {
    /// Its measured coordinates, in a metric frame.
    pub xyz: Vector3<f64>,
    /// Their standard deviation along each axis, in metres.
    pub sigma_m: f64,
    /// Whether it only tells of errors.
    pub is_check: bool,
    /// The images in which it is marked, with the pixels.
    pub marks: Vec<(ImageId, Vector2<f64>)>,
}

/// A point after the alignment.
#[derive(Clone, Debug, PartialEq)]
pub struct PointError {
    /// Number of marks in images with a pose, and of those that agree on one point.
    pub marks: [usize; 2],
    /// Its place in the model minus the measured one, in metres; `None` if the marks do not
    /// determine it.
    pub error_m: Option<Vector3<f64>>,
    /// Standard deviations of this error along the axes, in metres, without errors of the model.
    pub sigmas_m: Vector3<f64>,
    /// Whether the others contradict it.
    pub is_wrong: bool,
}

/// Why control points do not determine the similarity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ControlMisfit {
    /// There are fewer than three.
    TooFew {
        /// Number of points that are no check points and that their marks determine.
        usable: usize,
    },
    /// They leave a rotation or the scale uncertain: they are near a line, or near each other.
    Uncertain {
        /// Number of points that are no check points and that their marks determine.
        usable: usize,
        /// Standard deviation of the most uncertain rotation.
        rotation_sd_rad: f64,
        /// Standard deviation of the scale, relative to it.
        scale_sd: f64,
    },
    /// The model would be upside down: flat points are mirrored, as by swapped coordinates.
    UpsideDown,
}

/// A model in the frame of control points.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlAlignment {
    /// The similarity.
    pub term_from_model: Sim3,
    /// The points, in their order.
    pub points: Vec<PointError>,
}

/// A point that its marks determine in the model, with the covariance of marks by hand.
struct Found {
    xyz: Vector3<f64>,
    covariance: Matrix3<f64>,
    num_inliers: usize,
}

/// The similarity that brings the marked points of a model to their measured coordinates. A point
/// that the others contradict is left out: as long as the residuals are larger than chance
/// explains, that without which they are smallest.
///
/// # Errors
///
/// The points do not determine the similarity.
pub fn align_to_points(
    model: &Reconstruction,
    points: &[MarkedPoint],
) -> Result<ControlAlignment, ControlMisfit> {
    let found: Vec<Option<Found>> = points.iter().map(|point| in_model(model, point)).collect();
    let mut used: Vec<usize> =
        (0..points.len()).filter(|&k| found[k].is_some() && !points[k].is_check).collect();
    let fit = |used: &[usize]| fit(points, &found, used);
    let (mut similarity, mut cost) = fit(&used)?;
    // Four points are the fewest of which one can be wrong: three fit any one of two.
    while used.len() > MIN_POINTS && cost > max_cost(3 * used.len() - 7) {
        let without = (0..used.len()).filter_map(|k| {
            let mut others = used.clone();
            others.remove(k);
            fit(&others).ok().map(|(similarity, cost)| (cost, similarity, others))
        });
        let Some(best) = without.min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        (cost, similarity, used) = best;
    }
    let place = |&k: &usize| {
        Some(points[k].xyz.component_div(&sigmas(&points[k], found[k].as_ref()?, &similarity)))
    };
    let places: Vec<Vector3<f64>> = used.iter().filter_map(place).collect();
    if is_upside_down(&axes_of(model), &similarity, &places) {
        return Err(ControlMisfit::UpsideDown);
    }
    let of_point = |(k, point): (usize, &MarkedPoint)| {
        let registered = point.marks.iter().filter(|(image, _)| has_pose(model, *image)).count();
        let found = found[k].as_ref();
        PointError {
            marks: [registered, found.map_or(0, |found| found.num_inliers)],
            error_m: found.map(|found| similarity * found.xyz - point.xyz),
            sigmas_m: found
                .map_or(Vector3::repeat(f64::INFINITY), |found| sigmas(point, found, &similarity)),
            is_wrong: found.is_some() && !point.is_check && !used.contains(&k),
        }
    };
    let points = points.iter().enumerate().map(of_point).collect();
    Ok(ControlAlignment { term_from_model: similarity, points })
}

fn has_pose(model: &Reconstruction, image: ImageId) -> bool {
    model.image(image).cam_from_world().is_some()
}

fn in_model(model: &Reconstruction, point: &MarkedPoint) -> Option<Found> {
    let of_mark = |(image, pixel): &(ImageId, Vector2<f64>)| {
        let pose = model.image(*image).cam_from_world()?;
        let intrinsics = &model.camera_of(*image).intrinsics;
        Some((*image, ViewRay::new(pose, intrinsics, *pixel)?))
    };
    let (images, rays): (Vec<ImageId>, Vec<ViewRay>) =
        point.marks.iter().filter_map(of_mark).unzip();
    let found = triangulate(&rays, MAX_MARK_PX, MIN_ANGLE_RAD)?;
    let mut information = Matrix3::zeros();
    for &k in &found.inliers {
        let camera = model.camera_of(images[k]);
        let from_centre = found.xyz - model.image(images[k]).cam_from_world()?.origin_in_a();
        let direction = from_centre.normalize();
        let sigma = MARK_PX / camera.intrinsics.mean_focal_px() * from_centre.norm();
        information += (Matrix3::identity() - direction * direction.transpose()) / sigma.powi(2);
    }
    let covariance = information.try_inverse()?;
    Some(Found { xyz: found.xyz, covariance, num_inliers: found.inliers.len() })
}

/// Deviations of the error of a point in the measured frame.
fn sigmas(point: &MarkedPoint, found: &Found, similarity: &Sim3) -> Vector3<f64> {
    let rotation = similarity.rotation.to_rotation_matrix();
    let covariance = rotation * found.covariance * rotation.inverse();
    let variances = covariance.diagonal() * similarity.scale.powi(2);
    variances.map(|variance| (variance + point.sigma_m.powi(2)).sqrt())
}

/// The similarity of these points, and the sum of the squared residuals in their deviations.
fn fit(
    points: &[MarkedPoint],
    found: &[Option<Found>],
    used: &[usize],
) -> Result<(Sim3, f64), ControlMisfit> {
    let used: Vec<(&MarkedPoint, &Found)> =
        used.iter().filter_map(|&k| Some((&points[k], found[k].as_ref()?))).collect();
    let usable = used.len();
    if usable < MIN_POINTS {
        return Err(ControlMisfit::TooFew { usable });
    }
    let uncertain = |rotation_sd_rad, scale_sd| {
        Err(ControlMisfit::Uncertain { usable, rotation_sd_rad, scale_sd })
    };
    let (from, to): (Vec<Vector3<f64>>, Vec<Vector3<f64>>) =
        used.iter().map(|(point, found)| (found.xyz, point.xyz)).unzip();
    let Some(mut similarity) = solvers::umeyama(&from, &to, true) else {
        return uncertain(f64::INFINITY, f64::INFINITY);
    };
    let mut pairs = Vec::new();
    let mut variances = SVector::zeros();
    for _ in 0..2 {
        let pair = |(point, found): &(&MarkedPoint, &Found)| Pair {
            found: found.xyz,
            measured: point.xyz,
            sigmas: sigmas(point, found, &similarity),
            axes: Matrix3::identity(),
        };
        pairs = used.iter().map(pair).collect();
        (similarity, variances) = refined(&pairs, similarity, &Free::all());
    }
    let rotation_sd_rad = variances.fixed_rows::<3>(3).sum().sqrt();
    let scale_sd = variances[6].sqrt();
    let cost: f64 = pairs.iter().map(|pair| pair.whitened(&similarity).powi(2)).sum();
    // No number is within no bound.
    let is_certain = rotation_sd_rad <= MAX_SD && scale_sd <= MAX_SD && cost.is_finite();
    if !is_certain {
        return uncertain(rotation_sd_rad, scale_sd);
    }
    Ok((similarity, cost))
}

/// The 99.9 % quantile of χ² (Wilson & Hilferty 1931).
fn max_cost(degrees: usize) -> f64 {
    let d = degrees as f64;
    let part = 2.0 / (9.0 * d);
    d * (1.0 - part + QUANTILE * part.sqrt()).powi(3)
}
