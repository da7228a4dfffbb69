//! Cameras that are mounted on one vehicle: their mean relative pose and the offset of their clocks
//! from two trajectories.

use numpy::ndarray::Ix1;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tiepoint_geometry::Rigid3;
use tiepoint_sfm::rig::{
    RelativePose, Trajectory, find_offset, relative_pose_statistics, robust_average,
};

use crate::arrays::{numbers, pose, poses_of, require_same_length};
use crate::errors::invalid;

/// Times and poses of a trajectory, in order of time.
fn trajectory(
    [times, poses]: [&Bound<'_, PyAny>; 2],
    names: [&str; 2],
) -> PyResult<Vec<(f64, Rigid3)>> {
    let seconds = numbers::<Ix1>(times, names[0], "(N,)")?;
    let seconds = seconds.as_array();
    let poses = poses_of(poses, names[1])?;
    require_same_length(seconds.len(), poses.len(), names)?;
    let is_ascending = seconds.iter().zip(seconds.iter().skip(1)).all(|(one, next)| one < next);
    if !(seconds.iter().all(|time| time.is_finite()) && is_ascending) {
        return Err(invalid(format!("{} must be finite and ascending", names[0])));
    }
    Ok(seconds.iter().copied().zip(poses).collect())
}

/// The robust mean of the relative pose of two cameras over frames, from their poses
/// cam_from_world, (N, 3, 4) each: `cam2_from_cam1`, a matrix [R | t] of shape (3, 4), and how
/// constant it is: `median_baseline`, `rms_translation` (in the unit of the poses),
/// `rms_rotation` (in radians) and `second_over_first_half`, the ratio of the mean baselines of the
/// two halves, which is 1 without scale drift. None for fewer than two frames.
#[pyfunction]
pub(crate) fn average_relative_pose<'py>(
    python: Python<'py>,
    poses1: &Bound<'py, PyAny>,
    poses2: &Bound<'py, PyAny>,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let (one, other) = (poses_of(poses1, "poses1")?, poses_of(poses2, "poses2")?);
    require_same_length(one.len(), other.len(), ["poses1", "poses2"])?;
    let relative: Vec<RelativePose> =
        one.iter().zip(&other).map(|(one, other)| RelativePose::between(one, other)).collect();
    let (Some(mean), Some(statistics)) =
        (robust_average(&relative), relative_pose_statistics(&relative))
    else {
        return Ok(None);
    };
    let all = PyDict::new(python);
    all.set_item("cam2_from_cam1", pose(python, &mean.cam_from_rig()))?;
    all.set_item("median_baseline", statistics.median_baseline)?;
    all.set_item("rms_translation", statistics.rms_translation)?;
    all.set_item("rms_rotation", statistics.rms_rotation_rad)?;
    all.set_item("second_over_first_half", statistics.second_over_first_half)?;
    Ok(Some(all))
}

/// The offset of the clock of a second camera that is fixed to the first one, from the motion of
/// both: times in seconds, (N,), and poses cam_from_world, (N, 3, 4), of each in one frame. Returns
/// a dictionary with `offset`, in seconds, to add to `times2`, and `sd`, its standard deviation if
/// the errors of images are independent; None if too few images can be compared. The range is
/// ±1.5 s if the drives overlap on their clocks, else all offsets at which half of the shorter one
/// overlaps.
#[pyfunction]
pub(crate) fn clock_offset<'py>(
    python: Python<'py>,
    times1: &Bound<'py, PyAny>,
    poses1: &Bound<'py, PyAny>,
    times2: &Bound<'py, PyAny>,
    poses2: &Bound<'py, PyAny>,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let one = trajectory([times1, poses1], ["times1", "poses1"])?;
    let other = trajectory([times2, poses2], ["times2", "poses2"])?;
    let found = python.detach(|| find_offset(&Trajectory::new(one), &other));
    let Some(found) = found else { return Ok(None) };
    let all = PyDict::new(python);
    all.set_item("offset", found.offset_s)?;
    all.set_item("sd", found.sd_s)?;
    Ok(Some(all))
}
