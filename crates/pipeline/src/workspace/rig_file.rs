//! `rig.json`: the estimated rig extrinsics and time offsets with their covariance. The
//! `tiepoint.json` of a model holds the same, and commands read it there.

use std::cmp::Ordering;
use std::collections::BTreeSet;
use std::path::Path;

use serde::{Deserialize, Serialize};
use tiepoint_sfm::geometry::Rigid3;
use tiepoint_sfm::geometry::nalgebra::{Quaternion, UnitQuaternion, Vector3};
use tiepoint_sfm::rig::Clock;
use tiepoint_sfm::rigs::{
    CalibratedCamera, CalibratedRig, ClockState, NUMBERED_FRAME_S, RigConstraint, SensorPair,
};
use tiepoint_sfm::scene::Reconstruction;

use crate::Error;
use crate::workspace::format;
use crate::workspace::image_names::stream_of;

/// Largest accepted deviation of a quaternion's norm from 1: three digits are precise to less.
const UNIT_TOLERANCE: f64 = 1e-2;

/// The rig of a model. The rig frame is the frame of the reference camera, which is the first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object with the keys of rig.json")]
pub struct RigFile {
    /// Folder of the reference camera.
    pub reference: String,
    /// The other cameras.
    pub cameras: Vec<RigCamera>,
    /// Image pairs of one frame, reference camera first, whose relative pose contradicts the
    /// extrinsics, both in the model and by their own matches. The key is absent if there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bad_pairs: Vec<[String; 2]>,
}

/// A non-reference camera of a rig.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object that describes a camera")]
pub struct RigCamera {
    /// Its folder.
    pub name: String,
    /// Rotation of `cam_from_rig`: a Hamilton quaternion, w first.
    pub rotation_wxyz: [f64; 4],
    /// Translation of `cam_from_rig`, in units of the model.
    pub translation: [f64; 3],
    /// Its centre in the rig, in units of the model.
    pub centre_in_rig: [f64; 3],
    /// Its constraint to the extrinsics.
    pub constraint: ConstraintKind,
    /// Its clock relative to the reference camera's.
    pub clock: RigClock,
    /// Joint cluster-robust covariance, 8 x 8, of rotation (radians, R ← Exp(δ) R), translation
    /// (units of the model), offset (seconds, as the clock's) and skew, in this order. Rows of
    /// fixed parameters are zero; `None` where the images do not determine it. It is conditional on
    /// the scale of the model.
    pub covariance: Option<Vec<Vec<f64>>>,
    /// Largest standard deviation of the rotation about any axis, in degrees.
    pub rotation_sd_deg: Option<f64>,
    /// Largest standard deviation of the translation in any direction, in units of the model.
    pub translation_sd: Option<f64>,
    /// For cameras without common points: a unit vector in the rig frame along which the motion
    /// does not determine the position of the camera, such as the vertical on a flat road. The
    /// coordinate along it is set to zero.
    #[serde(default)]
    pub unobservable: Option<[f64; 3]>,
}

/// Constraint of a camera to its extrinsics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ConstraintKind {
    /// The relative poses of the frames agree with the extrinsics up to standard deviations.
    #[default]
    Soft,
    /// The poses of the frames satisfy the extrinsics exactly.
    Rigid,
}

impl From<RigConstraint> for ConstraintKind {
    fn from(constraint: RigConstraint) -> Self {
        match constraint {
            RigConstraint::Soft { .. } => Self::Soft,
            RigConstraint::Rigid => Self::Rigid,
        }
    }
}

/// State of a camera's time offset to the reference camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RigClockState {
    /// The cameras are triggered together, which fixes the offset.
    #[default]
    Synchronised,
    /// Offset and skew are estimated.
    Estimated,
    /// The images do not determine the offset. That of the time stamps is used. Not of numbered
    /// frames: there, images of the same number are synchronised.
    Unobservable,
}

impl From<ClockState> for RigClockState {
    fn from(state: ClockState) -> Self {
        match state {
            ClockState::Synchronised => Self::Synchronised,
            ClockState::Estimated => Self::Estimated,
            ClockState::Unobservable => Self::Unobservable,
        }
    }
}

impl From<RigClockState> for ClockState {
    fn from(state: RigClockState) -> Self {
        match state {
            RigClockState::Synchronised => Self::Synchronised,
            RigClockState::Estimated => Self::Estimated,
            RigClockState::Unobservable => Self::Unobservable,
        }
    }
}

/// Time of the reference camera = time + offset + drift (time − pivot).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object that describes a camera's clock")]
pub struct RigClock {
    /// Whether the offset was estimated.
    pub state: RigClockState,
    /// Time offset at the pivot, in seconds.
    pub offset_s: f64,
    /// Its standard deviation, if it was estimated.
    pub offset_sd_s: Option<f64>,
    /// Clock skew, in parts per million.
    pub drift_ppm: f64,
    /// Its standard deviation, if it was estimated.
    pub drift_sd_ppm: Option<f64>,
    /// Mid-time of this camera's images, on its own clock, in seconds.
    pub pivot_s: f64,
    /// Where images have no times and their frames are numbered: the assumed interval between two
    /// frames, in seconds. The time of a frame is its number times this interval, so that the
    /// offset is in seconds only if the interval is true. The key is absent where images have
    /// times, and where images of one number count as simultaneous.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub assumed_frame_s: Option<f64>,
}

impl RigFile {
    /// Whether it has a camera of this name.
    pub(crate) fn has_camera(&self, name: &str) -> bool {
        self.reference == name || self.cameras.iter().any(|camera| camera.name == name)
    }

    /// Checks what was read of a file at `path`.
    ///
    /// # Errors
    ///
    /// A camera is there twice, or a rotation is not a unit quaternion.
    pub(crate) fn validate(&self, path: &Path) -> Result<(), Error> {
        let broken = |what: String| Error::Broken { path: path.to_owned(), what };
        let mut names = BTreeSet::from([self.reference.as_str()]);
        for RigCamera { name, rotation_wxyz, clock, .. } in &self.cameras {
            if let Some(frame_s) = clock.assumed_frame_s.filter(|it| *it != NUMBERED_FRAME_S) {
                return Err(broken(format!(
                    "the frames of camera {name} count as {frame_s} s, and {NUMBERED_FRAME_S} s \
                    are expected"
                )));
            }
            if !names.insert(name) {
                return Err(broken(format!("the camera {name} is there twice")));
            }
            let norm = rotation_wxyz.iter().map(|value| value * value).sum::<f64>().sqrt();
            if (norm - 1.0).abs().partial_cmp(&UNIT_TOLERANCE) != Some(Ordering::Less) {
                return Err(broken(format!(
                    "the rotation of camera {name} has norm {norm} and not 1"
                )));
            }
        }
        Ok(())
    }

    /// The content of the file.
    pub(crate) fn to_json(&self) -> Vec<u8> {
        format::to_json(self)
    }

    /// The extrinsics of a model's rig; `None` if none were estimated.
    pub(crate) fn new(model: &Reconstruction, rig: &CalibratedRig) -> Option<Self> {
        let reference = stream_of(model, rig.cameras.first()?.sensor_pair.reference);
        let name = |image| model.image(image).name.clone();
        Some(Self {
            reference,
            cameras: rig.cameras.iter().map(|camera| RigCamera::new(model, camera)).collect(),
            bad_pairs: rig
                .bad_pairs
                .iter()
                .map(|pair| [name(pair.reference), name(pair.other)])
                .collect(),
        })
    }
}

impl RigClock {
    /// The offset with its standard deviation, in milliseconds or in frames.
    pub fn offset_text(&self) -> String {
        let (unit, unit_s) = match self.assumed_frame_s {
            Some(frame_s) => ("frames", frame_s),
            None => ("ms", 1e-3),
        };
        let sd = self.offset_sd_s.map(|sd_s| format!(" \u{b1} {:.2}", sd_s / unit_s));
        format!("{:+.2}{} {unit}", self.offset_s / unit_s, sd.unwrap_or_default())
    }

    /// What the offset is added to.
    pub fn added_to(&self) -> &'static str {
        if self.assumed_frame_s.is_some() { "numbers" } else { "times" }
    }

    /// The clock itself.
    pub(crate) fn clock(&self) -> Clock {
        let Self { offset_s, drift_ppm, pivot_s, .. } = *self;
        Clock { offset_s, drift: 1e-6 * drift_ppm, pivot_s }
    }
}

impl RigCamera {
    /// Its pose relative to the reference camera.
    pub(crate) fn cam_from_rig(&self) -> Rigid3 {
        let [w, x, y, z] = self.rotation_wxyz;
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
        Rigid3::new(rotation, Vector3::from(self.translation))
    }

    fn new(model: &Reconstruction, camera: &CalibratedCamera) -> Self {
        let (pose, clock) = (&camera.cam_from_rig, &camera.sensor_pair.clock);
        let q = &pose.rotation;
        let sd =
            |index: usize| camera.covariance.map(|covariance| covariance[(index, index)].sqrt());
        let largest_sd = |first: usize| {
            let block = camera.covariance?.fixed_view::<3, 3>(first, first).into_owned();
            Some(block.symmetric_eigenvalues().max().max(0.0).sqrt())
        };
        let SensorPair { other, clock_state, .. } = camera.sensor_pair;
        let is_estimated = clock_state == ClockState::Estimated;
        let counts_frames = camera.sensor_pair.counts_frames(model);
        Self {
            name: stream_of(model, other),
            rotation_wxyz: [q.w, q.i, q.j, q.k],
            translation: pose.translation.into(),
            centre_in_rig: pose.origin_in_a().into(),
            constraint: camera.constraint.into(),
            clock: RigClock {
                state: clock_state.into(),
                offset_s: clock.offset_s,
                offset_sd_s: sd(6).filter(|_| is_estimated),
                drift_ppm: 1e6 * clock.drift,
                drift_sd_ppm: sd(7).filter(|_| is_estimated).map(|sd| 1e6 * sd),
                pivot_s: clock.pivot_s,
                assumed_frame_s: counts_frames.then_some(NUMBERED_FRAME_S),
            },
            covariance: camera.covariance.map(|covariance| {
                covariance.row_iter().map(|row| row.iter().copied().collect()).collect()
            }),
            rotation_sd_deg: largest_sd(0).map(f64::to_degrees),
            translation_sd: largest_sd(3),
            unobservable: camera.sensor_pair.unobservable_direction.map(Into::into),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig(names: &[&str], rotation_wxyz: [f64; 4]) -> RigFile {
        let camera = |name: &&str| RigCamera {
            name: (*name).to_owned(),
            rotation_wxyz,
            ..RigCamera::default()
        };
        let cameras = names.iter().map(camera).collect();
        RigFile { reference: "left".to_owned(), cameras, bad_pairs: Vec::new() }
    }

    #[test]
    fn a_camera_that_is_there_twice_is_refused() {
        let check = |names: &[&str]| rig(names, [1.0, 0.0, 0.0, 0.0]).validate(Path::new("ws/a"));
        assert!(check(&["right", "rear"]).is_ok());
        for (names, twice) in [(["right", "left"], "left"), (["right", "right"], "right")] {
            let error = check(&names).unwrap_err().to_string();
            assert!(error.contains(&format!("ws/a: the camera {twice} is there twice")), "{error}");
        }
    }

    #[test]
    fn frames_count_as_the_time_that_is_computed_with() {
        let with = |frame_s| {
            let mut rig = rig(&["right"], [1.0, 0.0, 0.0, 0.0]);
            rig.cameras[0].clock.assumed_frame_s = Some(frame_s);
            rig.validate(Path::new("ws/a"))
        };
        assert!(with(NUMBERED_FRAME_S).is_ok());
        let error = with(0.04).unwrap_err().to_string();
        assert!(error.contains("ws/a: the frames of camera right count as 0.04 s"), "{error}");
    }

    #[test]
    fn rotation_that_is_not_a_unit_quaternion_is_rejected() {
        let check = |rotation| rig(&["right"], rotation).validate(Path::new("ws/a"));
        assert!(check([0.5, -0.5, 0.5, 0.5]).is_ok() && check([0.0, 0.707, 0.0, 0.707]).is_ok());
        for none in [
            [0.0; 4],
            [1e-9, 0.0, 0.0, 0.0],
            [1e200, 0.0, 0.0, 1e200],
            [2.0, 0.0, 0.0, 0.0],
            [f64::NAN; 4],
        ] {
            let error = check(none).unwrap_err().to_string();
            assert!(error.contains("ws/a: the rotation of camera right has norm"), "{error}");
        }
    }
}
