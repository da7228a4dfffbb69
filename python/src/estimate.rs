//! Relative and absolute poses, homographies and fundamental matrices by RANSAC.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use tiepoint_geometry::nalgebra::{Matrix3, Vector2};
use tiepoint_geometry::{RansacOptions, Report, estimate};

use crate::arrays::{matrix3, pose, require_same_length, rows, vector};
use crate::camera::Camera;
use crate::errors::invalid;

/// An estimator of a matrix from points of two images.
type Estimate =
    fn(&[Vector2<f64>], &[Vector2<f64>], &RansacOptions) -> Option<Report<Matrix3<f64>>>;

/// The options; an error if they are out of range.
fn options(max_error: f64, seed: u64) -> PyResult<RansacOptions> {
    if !(max_error.is_finite() && max_error > 0.0) {
        return Err(invalid("max_error must be a number of pixels greater than 0"));
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

/// Estimates a matrix from points of two images.
fn from_points<'py>(
    python: Python<'py>,
    [points1, points2]: [&Bound<'py, PyAny>; 2],
    options: &RansacOptions,
    name: &str,
    estimate: Estimate,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let (one, other) = (rows::<2>(points1, "points1")?, rows::<2>(points2, "points2")?);
    require_same_length(one.len(), other.len(), ["points1", "points2"])?;
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
    let (one, other) = (rows::<2>(pixels1, "pixels1")?, rows::<2>(pixels2, "pixels2")?);
    require_same_length(one.len(), other.len(), ["pixels1", "pixels2"])?;
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
        (rows::<2>(pixels, "pixels")?, rows::<3>(points_in_world, "points_in_world")?);
    require_same_length(pixels.len(), points.len(), ["pixels", "points_in_world"])?;
    let options = options(max_error, seed)?;
    let intrinsics = camera.camera.intrinsics;
    let report = python.detach(|| estimate::absolute_pose(&pixels, &points, &intrinsics, &options));
    found(python, report, "cam_from_world", |model| pose(python, model).into_any())
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
