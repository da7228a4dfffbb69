//! Relative and absolute poses, homographies, fundamental matrices, similarities and points by
//! RANSAC.

use numpy::IntoPyArray;
use numpy::ndarray::{Array2, Ix1};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tiepoint_geometry::estimate::{RigCamera, RigObservation};
use tiepoint_geometry::nalgebra::{Matrix3, SVector, Vector2};
use tiepoint_geometry::triangulate::ViewRay;
use tiepoint_geometry::{RansacOptions, Report, Sim3, estimate};

use crate::arrays::{
    invalid_array, matrix3, numbers, pose, poses_of, require_same_length, rows, vector,
};
use crate::camera::Camera;
use crate::errors::invalid;

/// An estimator of a matrix from points of two images.
type Estimate =
    fn(&[Vector2<f64>], &[Vector2<f64>], &RansacOptions) -> Option<Report<Matrix3<f64>>>;

/// The options; an error if they are out of range.
fn options(max_error: f64, seed: u64) -> PyResult<RansacOptions> {
    if !(max_error.is_finite() && max_error > 0.0) {
        return Err(invalid("max_error must be a number greater than 0"));
    }
    Ok(RansacOptions { max_error, seed, ..RansacOptions::default() })
}

/// The dictionary of a model and its inliers.
fn found<'py, M>(
    python: Python<'py>,
    report: Option<Report<M>>,
    name: &str,
    array: impl Fn(&M) -> Bound<'py, PyAny>,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let Some(report) = report else { return Ok(None) };
    let all = PyDict::new(python);
    all.set_item(name, array(&report.model))?;
    all.set_item("num_inliers", report.num_inliers)?;
    all.set_item("inliers", vector(python, report.inliers))?;
    Ok(Some(all))
}

/// Rows of an array.
type Rows<const N: usize> = Vec<SVector<f64, N>>;

/// Two arrays of corresponding rows; an error names them.
fn corresponding<const A: usize, const B: usize>(
    [one, other]: [&Bound<'_, PyAny>; 2],
    names: [&str; 2],
) -> PyResult<(Rows<A>, Rows<B>)> {
    let (one, other) = (rows::<A>(one, names[0])?, rows::<B>(other, names[1])?);
    require_same_length(one.len(), other.len(), names)?;
    Ok((one, other))
}

/// Estimates a matrix from points of two images.
fn from_points<'py>(
    python: Python<'py>,
    points: [&Bound<'py, PyAny>; 2],
    options: &RansacOptions,
    name: &str,
    estimate: Estimate,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let (one, other) = corresponding::<2, 2>(points, ["points1", "points2"])?;
    let report = python.detach(|| estimate(&one, &other, options));
    found(python, report, name, |model| matrix3(python, model).into_any())
}

/// The relative pose of two calibrated cameras from corresponding pixels, (N, 2) each. Returns a
/// dictionary with `cam2_from_cam1`, a matrix [R | t] of shape (3, 4) with |t| = 1, `num_inliers`
/// and the mask `inliers`; None if no pose has enough inliers. `max_error` is a Sampson error in
/// pixels.
#[pyfunction]
#[pyo3(signature = (pixels1, pixels2, camera1, camera2, *, max_error=4.0, seed=0))]
pub(crate) fn relative_pose<'py>(
    python: Python<'py>,
    pixels1: &Bound<'py, PyAny>,
    pixels2: &Bound<'py, PyAny>,
    camera1: Camera,
    camera2: Camera,
    max_error: f64,
    seed: u64,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let (one, other) = corresponding::<2, 2>([pixels1, pixels2], ["pixels1", "pixels2"])?;
    let options = options(max_error, seed)?;
    let [camera1, camera2] = [camera1, camera2].map(|camera| camera.camera.intrinsics);
    let report =
        python.detach(|| estimate::relative_pose(&one, &other, &camera1, &camera2, &options));
    found(python, report, "cam2_from_cam1", |model| pose(python, model).into_any())
}

/// The pose of a calibrated camera from pixels, (N, 2), and points in the world, (N, 3). Returns a
/// dictionary with `cam_from_world`, a matrix [R | t] of shape (3, 4), `num_inliers` and the mask
/// `inliers`; None if no pose has enough inliers. `max_error` is a reprojection error in pixels.
#[pyfunction]
#[pyo3(signature = (pixels, points_in_world, camera, *, max_error=4.0, seed=0))]
pub(crate) fn absolute_pose<'py>(
    python: Python<'py>,
    pixels: &Bound<'py, PyAny>,
    points_in_world: &Bound<'py, PyAny>,
    camera: Camera,
    max_error: f64,
    seed: u64,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let (pixels, points) =
        corresponding::<2, 3>([pixels, points_in_world], ["pixels", "points_in_world"])?;
    let options = options(max_error, seed)?;
    let intrinsics = camera.camera.intrinsics;
    let report = python.detach(|| estimate::absolute_pose(&pixels, &points, &intrinsics, &options));
    found(python, report, "cam_from_world", |model| pose(python, model).into_any())
}

/// The pose of a rig of calibrated cameras from pixels, (N, 2), of points in the world, (N, 3);
/// `camera_indices`, (N,), says which of `cameras` each pixel is of, and `cams_from_rig`, of shape
/// (C, 3, 4), has their poses on the rig. Returns a dictionary with `rig_from_world`, a matrix
/// [R | t] of shape (3, 4), `num_inliers` and the mask `inliers`; None if no pose has enough
/// inliers. `max_error` is a reprojection error in pixels.
#[pyfunction]
#[pyo3(signature = (
    pixels, points_in_world, camera_indices, cams_from_rig, cameras, *, max_error=4.0, seed=0
))]
#[allow(clippy::too_many_arguments, reason = "arguments of Python")]
pub(crate) fn generalized_absolute_pose<'py>(
    python: Python<'py>,
    pixels: &Bound<'py, PyAny>,
    points_in_world: &Bound<'py, PyAny>,
    camera_indices: &Bound<'py, PyAny>,
    cams_from_rig: &Bound<'py, PyAny>,
    cameras: Vec<Camera>,
    max_error: f64,
    seed: u64,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let (pixels, points) =
        corresponding::<2, 3>([pixels, points_in_world], ["pixels", "points_in_world"])?;
    let indices = numbers::<Ix1>(camera_indices, "camera_indices", "(N,)")?;
    let indices = indices.as_array();
    require_same_length(pixels.len(), indices.len(), ["pixels", "camera_indices"])?;
    let count = cameras.len();
    if !indices.iter().all(|index| (0..count).any(|camera| *index == camera as f64)) {
        return Err(invalid(format!("camera_indices must be of the {count} cameras")));
    }
    let on_rig = poses_of(cams_from_rig, "cams_from_rig")?;
    require_same_length(on_rig.len(), count, ["cams_from_rig", "cameras"])?;
    let rig: Vec<RigCamera> = on_rig
        .into_iter()
        .zip(cameras)
        .map(|(cam_from_rig, camera)| RigCamera {
            intrinsics: camera.camera.intrinsics,
            cam_from_rig,
        })
        .collect();
    let observations: Vec<RigObservation> = pixels
        .into_iter()
        .zip(points)
        .zip(indices)
        .map(|((pixel, point_in_world), camera)| RigObservation {
            camera: *camera as usize,
            pixel,
            point_in_world,
        })
        .collect();
    let options = options(max_error, seed)?;
    let report =
        python.detach(|| estimate::generalized_absolute_pose(&rig, &observations, &options));
    found(python, report, "rig_from_world", |model| pose(python, model).into_any())
}

/// The similarity that maps points, (N, 3), onto others, (N, 3), some of which may be wrong.
/// Returns a dictionary with `b_from_a`, a matrix [sR | t] of shape (3, 4), its `scale`,
/// `num_inliers` and the mask `inliers`; None if none has enough inliers. `max_error` is a distance
/// in the unit of `points_b`. Without `with_scale` the scale is 1.
#[pyfunction]
#[pyo3(signature = (points_a, points_b, *, max_error, with_scale=true, seed=0))]
pub(crate) fn similarity<'py>(
    python: Python<'py>,
    points_a: &Bound<'py, PyAny>,
    points_b: &Bound<'py, PyAny>,
    max_error: f64,
    with_scale: bool,
    seed: u64,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let (from, to) = corresponding::<3, 3>([points_a, points_b], ["points_a", "points_b"])?;
    let options = options(max_error, seed)?;
    let report = python.detach(|| estimate::similarity(&from, &to, with_scale, &options));
    let scale = report.as_ref().map(|report| report.model.scale);
    let all = found(python, report, "b_from_a", |model: &Sim3| {
        let linear = model.scale * model.rotation.to_rotation_matrix().matrix();
        let entry = |(row, column)| match column {
            3 => model.translation[row],
            _ => linear[(row, column)],
        };
        Array2::from_shape_fn((3, 4), entry).into_pyarray(python).into_any()
    })?;
    if let (Some(all), Some(scale)) = (&all, scale) {
        all.set_item("scale", scale)?;
    }
    Ok(all)
}

/// The point that calibrated images see at pixels, (N, 2): `poses` are their cam_from_world, of
/// shape (N, 3, 4), and `cameras` a camera or a list of N. Returns a dictionary with `point`, of
/// shape (3,), and the mask `inliers`; None if fewer than two pixels agree, or if their rays meet
/// at an angle below `min_angle`, in degrees. `max_error` is a reprojection error in pixels.
#[pyfunction]
#[pyo3(signature = (pixels, poses, cameras, *, max_error=4.0, min_angle=1.5))]
pub(crate) fn triangulate<'py>(
    python: Python<'py>,
    pixels: &Bound<'py, PyAny>,
    poses: &Bound<'py, PyAny>,
    cameras: &Bound<'py, PyAny>,
    max_error: f64,
    min_angle: f64,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let (all_pixels, all_poses) = (rows::<2>(pixels, "pixels")?, poses_of(poses, "poses")?);
    let count = all_pixels.len();
    require_same_length(count, all_poses.len(), ["pixels", "poses"])?;
    let cameras: Vec<Camera> = match cameras.extract::<Camera>() {
        Ok(camera) => vec![camera; count],
        Err(_) => cameras
            .extract()
            .map_err(|_| invalid_array(cameras, "cameras", "Camera", &format!("({count},)")))?,
    };
    require_same_length(count, cameras.len(), ["pixels", "cameras"])?;
    options(max_error, 0)?;
    if !(0.0..180.0).contains(&min_angle) {
        return Err(invalid("min_angle must be a number of degrees from 0 to below 180"));
    }
    let views = all_poses.iter().zip(&cameras).zip(&all_pixels).enumerate();
    let (indices, rays): (Vec<usize>, Vec<ViewRay>) = views
        .filter_map(|(index, ((pose, camera), pixel))| {
            Some((index, ViewRay::new(pose, &camera.camera.intrinsics, *pixel)?))
        })
        .unzip();
    let point =
        tiepoint_geometry::triangulate::triangulate(&rays, max_error, min_angle.to_radians());
    let Some(point) = point else { return Ok(None) };
    let mut inliers = vec![false; count];
    for inlier in point.inliers {
        inliers[indices[inlier]] = true;
    }
    let all = PyDict::new(python);
    all.set_item("point", vector(python, point.xyz.as_slice().to_vec()))?;
    all.set_item("inliers", vector(python, inliers))?;
    Ok(Some(all))
}

/// The homography H that maps points of the first image, (N, 2), to those of the second. Returns a
/// dictionary with `homography`, of shape (3, 3) and Frobenius norm 1, `num_inliers` and the mask
/// `inliers`; None if none has enough inliers. `max_error` is a transfer error in pixels.
#[pyfunction]
#[pyo3(signature = (points1, points2, *, max_error=4.0, seed=0))]
pub(crate) fn homography<'py>(
    python: Python<'py>,
    points1: &Bound<'py, PyAny>,
    points2: &Bound<'py, PyAny>,
    max_error: f64,
    seed: u64,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let options = options(max_error, seed)?;
    from_points(python, [points1, points2], &options, "homography", estimate::homography)
}

/// The fundamental matrix F of two images, x2ᵀ F x1 = 0, from corresponding pixels, (N, 2) each.
/// Returns a dictionary with `fundamental`, of shape (3, 3) and Frobenius norm 1, `num_inliers` and
/// the mask `inliers`; None if none has enough inliers. `max_error` is a Sampson error in pixels.
#[pyfunction]
#[pyo3(signature = (points1, points2, *, max_error=4.0, seed=0))]
pub(crate) fn fundamental<'py>(
    python: Python<'py>,
    points1: &Bound<'py, PyAny>,
    points2: &Bound<'py, PyAny>,
    max_error: f64,
    seed: u64,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let options = options(max_error, seed)?;
    from_points(python, [points1, points2], &options, "fundamental", estimate::fundamental)
}
