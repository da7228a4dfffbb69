//! `rig.json`: the calibration that was found, with its uncertainty, and the clocks.

use std::cmp::Ordering;
use std::path::Path;

use serde::{Deserialize, Serialize};
use tiepoint_sfm::geometry::Rigid3;
use tiepoint_sfm::geometry::nalgebra::{Quaternion, UnitQuaternion, Vector3};
use tiepoint_sfm::scene::Reconstruction;
use tiepoint_sfm::{CalibratedCamera, CalibratedRig, ClockState, RigConstraint};

use crate::Error;
use crate::image_names::folder_of;

/// The norm of a quaternion of three digits differs from 1 by less.
const UNIT_TOLERANCE: f64 = 1e-2;

/// The rig of a model: its frame is that of the first camera.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RigFile {
    /// The folder of the first camera, whose clock the others' are related to.
    pub reference: String,
    /// The others.
    pub cameras: Vec<RigCamera>,
    /// Images of one moment, the first camera's and another's, that are wrong: they agree neither
    /// in the model nor by their own matches with the mounting. `None` in files of versions before
    /// this was written.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bad_pairs: Option<Vec<[String; 2]>>,
}

/// A camera beside the first one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RigCamera {
    /// Its folder.
    pub name: String,
    /// Rotation of `cam_from_rig`: a Hamilton quaternion, w first.
    pub rotation_wxyz: [f64; 4],
    /// Translation of `cam_from_rig`, in units of the model.
    pub translation: [f64; 3],
    /// Its centre in the rig, in units of the model.
    pub centre_in_rig: [f64; 3],
    /// soft or hard: whether its poses are rigid frames with the first camera's.
    pub hold: String,
    /// What turns its times into the first camera's.
    pub clock: RigClock,
    /// Joint covariance of rotation (radians, R ← Exp(δ) R), translation, offset (seconds) and
    /// drift, rows in this order; zeros where something is held, none where it is not determined.
    /// The size of the model is held, not part of it.
    pub covariance: Option<Vec<Vec<f64>>>,
    /// Largest standard deviation of the rotation about any axis.
    pub rotation_sd_deg: Option<f64>,
    /// Largest standard deviation of the translation in any direction.
    pub translation_sd: Option<f64>,
    /// Of cameras that see nothing in common: a direction in the rig along which the motion does
    /// not tell where the camera is, as upwards on a flat road. Its place along it is a guess:
    /// zero.
    #[serde(default)]
    pub unobservable: Option<[f64; 3]>,
}

/// Time of the first camera = time + offset + drift (time − pivot).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RigClock {
    /// together: the cameras take their images at the same instants, which fixes the offset; free:
    /// found from the images; not observable: the images tell too little, and the offset is what
    /// the time stamps say.
    pub timing: String,
    /// Offset at the pivot.
    pub offset_s: f64,
    /// Its standard deviation, where it was found.
    pub offset_sd_s: Option<f64>,
    /// Drift, in parts per million.
    pub drift_ppm: f64,
    /// Its standard deviation, where it was found.
    pub drift_sd_ppm: Option<f64>,
    /// The middle of this camera's images, on its own clock.
    pub pivot_s: f64,
}

impl RigFile {
    /// From the text of the file at `path`.
    pub(crate) fn from_json(path: &Path, text: &[u8]) -> Result<Self, Error> {
        let broken = |what: String| Error::Broken { path: path.to_owned(), what };
        let file: Self = serde_json::from_slice(text).map_err(|error| broken(error.to_string()))?;
        for RigCamera { name, rotation_wxyz, .. } in &file.cameras {
            let norm = rotation_wxyz.iter().map(|value| value * value).sum::<f64>().sqrt();
            if (norm - 1.0).abs().partial_cmp(&UNIT_TOLERANCE) != Some(Ordering::Less) {
                return Err(broken(format!(
                    "the rotation of camera {name} has norm {norm} and not 1"
                )));
            }
        }
        Ok(file)
    }

    /// `None` without a camera that is held to the first one.
    pub(crate) fn new(model: &Reconstruction, rig: &CalibratedRig) -> Option<Self> {
        let reference = folder_of(model, rig.cameras.first()?.sensor_pair.left);
        let name = |image| model.image(image).name.clone();
        Some(Self {
            reference,
            cameras: rig.cameras.iter().map(|camera| RigCamera::new(model, camera)).collect(),
            bad_pairs: Some(
                rig.bad_pairs.iter().map(|pair| [name(pair.left), name(pair.right)]).collect(),
            ),
        })
    }
}

impl RigCamera {
    /// Its pose on the rig.
    pub(crate) fn cam_from_rig(&self) -> Rigid3 {
        let [w, x, y, z] = self.rotation_wxyz;
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
        Rigid3::new(rotation, Vector3::from(self.translation))
    }

    fn new(model: &Reconstruction, camera: &CalibratedCamera) -> Self {
        let (pose, clock) = (&camera.right_from_left, &camera.sensor_pair.clock);
        let q = &pose.rotation;
        let sd =
            |index: usize| camera.covariance.map(|covariance| covariance[(index, index)].sqrt());
        let widest = |first: usize| {
            let block = camera.covariance?.fixed_view::<3, 3>(first, first).into_owned();
            Some(block.symmetric_eigenvalues().max().max(0.0).sqrt())
        };
        let is_free = camera.sensor_pair.clock_state == ClockState::Estimated;
        Self {
            name: folder_of(model, camera.sensor_pair.right),
            rotation_wxyz: [q.w, q.i, q.j, q.k],
            translation: pose.translation.into(),
            centre_in_rig: pose.origin_in_a().into(),
            hold: match camera.constraint {
                RigConstraint::Soft { .. } => "soft",
                RigConstraint::Rigid => "hard",
            }
            .to_owned(),
            clock: RigClock {
                timing: match camera.sensor_pair.clock_state {
                    ClockState::Synchronised => "together",
                    ClockState::Estimated => "free",
                    ClockState::Unobservable => "not observable",
                }
                .to_owned(),
                offset_s: clock.offset_s,
                offset_sd_s: sd(6).filter(|_| is_free),
                drift_ppm: 1e6 * clock.drift,
                drift_sd_ppm: sd(7).filter(|_| is_free).map(|sd| 1e6 * sd),
                pivot_s: clock.pivot_s,
            },
            covariance: camera.covariance.map(|covariance| {
                covariance.row_iter().map(|row| row.iter().copied().collect()).collect()
            }),
            rotation_sd_deg: widest(0).map(f64::to_degrees),
            translation_sd: widest(3),
            unobservable: camera.sensor_pair.unobservable_direction.map(Into::into),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotation_that_is_none_is_refused() {
        let read = |rotation_wxyz| {
            let camera =
                RigCamera { name: "right".to_owned(), rotation_wxyz, ..RigCamera::default() };
            let file =
                RigFile { reference: "left".to_owned(), cameras: vec![camera], bad_pairs: None };
            RigFile::from_json(Path::new("ws/rig.json"), &serde_json::to_vec(&file).unwrap())
        };
        assert!(read([0.5, -0.5, 0.5, 0.5]).is_ok() && read([0.0, 0.707, 0.0, 0.707]).is_ok());
        for none in
            [[0.0; 4], [1e-9, 0.0, 0.0, 0.0], [1e200, 0.0, 0.0, 1e200], [2.0, 0.0, 0.0, 0.0]]
        {
            let error = read(none).unwrap_err().to_string();
            assert!(
                error.contains("ws/rig.json: the rotation of camera right has norm"),
                "{error}"
            );
        }
        // serde_json writes what is not finite as null, and refuses that and 1e999 when it reads.
        assert!(read([f64::NAN; 4]).is_err());
    }
}
