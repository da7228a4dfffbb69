//! The extrinsics of Kalibr's camchain (<https://github.com/ethz-asl/kalibr/wiki/yaml-formats>).
//!
//! `T_cn_cnm1` is cam_n_from_cam_{n−1}. A calibration with an IMU has `T_cam_imu` = cam_from_imu
//! and `timeshift_cam_imu`: time of the IMU = time of the camera + timeshift. The first camera is
//! the reference. `timeshift_cam0` is the same with the first camera in place of the IMU, which our
//! export writes.

use std::path::Path;

use tiepoint_geometry::Rigid3;

use super::camera_on_rig::{CameraOnRig, PhotosOfCamera};
use super::rotation::pose_of_matrix;
use crate::calibration::kalibr::{cameras, is_camchain, is_camera};
use crate::yaml::{self, Node};
use crate::{Error, Result};

/// The rig of the camchain with this text.
pub(super) fn rig(path: &Path, text: &str) -> Result<Vec<CameraOnRig>> {
    let root = yaml::parse(path, text)?;
    if !is_camchain(&root) {
        return Err(Error::content(
            path,
            "is no known rig: give COLMAP's rig_config.json or Kalibr's camchain",
        ));
    }
    let calibrations = cameras(path, &root)?;
    let nodes = root.entries().iter().filter(|(name, _)| is_camera(name));
    let mut rig: Vec<CameraOnRig> = Vec::new();
    let mut first: Option<(Option<Rigid3>, f64)> = None;
    for ((name, node), calibration) in nodes.zip(calibrations) {
        let from_imu = pose(path, node, name, "T_cam_imu")?;
        let shift_s = |key: &str| match node.get(key) {
            None => Ok(None),
            Some(found) => found.number(path, &format!("{key} of {name}")).map(Some),
        };
        let to_first_s = shift_s("timeshift_cam0")?;
        let shift_s = shift_s("timeshift_cam_imu")?.unwrap_or(0.0);
        let &mut (first_from_imu, first_shift_s) = first.get_or_insert((from_imu, shift_s));
        let cam_from_rig = match (rig.last(), pose(path, node, name, "T_cn_cnm1")?) {
            (None, _) => Rigid3::identity(),
            (Some(before), Some(cam_from_before)) => cam_from_before * before.cam_from_rig,
            (Some(_), None) => match (from_imu, first_from_imu) {
                (Some(from_imu), Some(first_from_imu)) => from_imu * first_from_imu.inverse(),
                _ => return Err(node.error(path, format!("{name} has no T_cn_cnm1"))),
            },
        };
        rig.push(CameraOnRig {
            photos: PhotosOfCamera::Named { name: name.clone(), topic: calibration.topic.clone() },
            cam_from_rig,
            time_offset_s: to_first_s.unwrap_or(shift_s - first_shift_s),
            calibration: Some(calibration),
        });
    }
    Ok(rig)
}

/// The pose under a key of a camera, if it has the key.
fn pose(path: &Path, node: &Node, name: &str, key: &str) -> Result<Option<Rigid3>> {
    let Some(found) = node.get(key) else { return Ok(None) };
    let fails = |what: String| -> Error { found.error(path, format!("{key} of {name} {what}")) };
    let numbers = found.numbers(path, &format!("{key} of {name}"))?;
    let count = numbers.len();
    let matrix: [f64; 16] =
        numbers.try_into().map_err(|_| fails(format!("has {count} numbers in place of 16")))?;
    pose_of_matrix(&matrix).map(Some).map_err(fails)
}
