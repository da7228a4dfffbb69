//! COLMAP's `rig_config.json` (<https://colmap.github.io/rigs.html>): a list of rigs, each with its
//! cameras. Rotations are Hamilton quaternions, w first.

use std::collections::BTreeSet;
use std::path::Path;

use serde::Deserialize;
use tiepoint_geometry::nalgebra::Vector3;
use tiepoint_geometry::{CameraModelKind, Intrinsics, Rigid3};

use super::camera_on_rig::{CameraOnRig, PhotosOfCamera};
use super::rotation::rotation_of_quaternion;
use crate::calibration::CameraCalibration;
use crate::text::excerpt::Excerpt;
use crate::{Error, Result};

#[derive(Deserialize)]
#[serde(expecting = "a rig, as {\"cameras\": [...]}")]
struct RigEntry {
    cameras: Vec<CameraEntry>,
}

#[derive(Deserialize)]
#[serde(expecting = "a camera, as {\"image_prefix\": \"left/\", ...}")]
struct CameraEntry {
    image_prefix: String,
    #[serde(default)]
    ref_sensor: bool,
    cam_from_rig_rotation: Option<[f64; 4]>,
    cam_from_rig_translation: Option<[f64; 3]>,
    camera_model_name: Option<String>,
    camera_params: Option<Vec<f64>>,
}

/// The rigs of the file with this text.
pub(super) fn rigs(path: &Path, text: &str) -> Result<Vec<Vec<CameraOnRig>>> {
    let entries: Vec<RigEntry> = serde_json::from_str(text).map_err(|cause| Error::Line {
        path: path.to_owned(),
        line: cause.line(),
        what: format!("is no rig_config.json: {cause}"),
    })?;
    if entries.is_empty() {
        return Err(Error::content(path, "has no rig"));
    }
    let mut prefixes = BTreeSet::new();
    for camera in entries.iter().flat_map(|rig| &rig.cameras) {
        if !prefixes.insert(camera.image_prefix.as_str()) {
            let prefix = Excerpt(&camera.image_prefix);
            return Err(Error::content(
                path,
                format!("has the image_prefix \"{prefix}\" twice: a camera is on one rig, once"),
            ));
        }
    }
    entries.iter().enumerate().map(|(index, rig)| rig_of(path, index, rig)).collect()
}

fn rig_of(path: &Path, index: usize, rig: &RigEntry) -> Result<Vec<CameraOnRig>> {
    let num_references = rig.cameras.iter().filter(|camera| camera.ref_sensor).count();
    if num_references != 1 {
        let what = format!(
            "rig {} has {num_references} reference cameras: give one of its cameras \
            \"ref_sensor\": true",
            index + 1
        );
        return Err(Error::content(path, what));
    }
    let (references, others): (Vec<_>, Vec<_>) =
        rig.cameras.iter().partition(|camera| camera.ref_sensor);
    references.into_iter().chain(others).map(|camera| camera_of(path, camera)).collect()
}

fn camera_of(path: &Path, camera: &CameraEntry) -> Result<CameraOnRig> {
    let prefix = Excerpt(&camera.image_prefix);
    let fails = |what: String| Error::content(path, format!("the camera \"{prefix}\" {what}"));
    let cam_from_rig = match (camera.cam_from_rig_rotation, camera.cam_from_rig_translation) {
        (Some(rotation), Some(translation)) => {
            let rotation = rotation_of_quaternion(rotation)
                .map_err(|what| fails(format!("has a cam_from_rig_rotation that {what}")))?;
            Rigid3 { rotation, translation: Vector3::from(translation) }
        }
        (None, None) if camera.ref_sensor => Rigid3::identity(),
        _ => {
            let what = "needs both cam_from_rig_rotation and cam_from_rig_translation; without \
                        known poses leave the file out, and the rig is estimated";
            return Err(fails(what.to_owned()));
        }
    };
    if camera.ref_sensor && cam_from_rig != Rigid3::identity() {
        return Err(fails("is the reference camera, whose pose is the identity".to_owned()));
    }
    let calibration = match (&camera.camera_model_name, &camera.camera_params) {
        (None, None) => None,
        (Some(name), Some(params)) => {
            let intrinsics = CameraModelKind::from_name(name)
                .and_then(|kind| Intrinsics::new(kind, params))
                .map_err(|cause| fails(format!("has wrong intrinsics: {cause}")))?;
            Some(CameraCalibration {
                name: camera.image_prefix.clone(),
                topic: None,
                size: None,
                intrinsics,
            })
        }
        _ => {
            let what = "needs both camera_model_name and camera_params, or neither";
            return Err(fails(what.to_owned()));
        }
    };
    Ok(CameraOnRig {
        photos: PhotosOfCamera::Prefix(camera.image_prefix.clone()),
        cam_from_rig,
        time_offset_s: 0.0,
        calibration,
    })
}
