//! A camera of a known rig.

use tiepoint_geometry::Rigid3;

use crate::calibration::CameraCalibration;

/// The photos that a camera of a rig took.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PhotosOfCamera {
    /// Those whose names begin with this text (COLMAP's `image_prefix`).
    Prefix(String),
    /// Those of the folder that has this name, or has it as a part of the topic of a recording
    /// (Kalibr's `cam0` and `rostopic`).
    Named {
        /// Name of the camera.
        name: String,
        /// Name of the recording.
        topic: Option<String>,
    },
}

/// A camera of a rig with known extrinsics.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraOnRig {
    /// Its photos.
    pub photos: PhotosOfCamera,
    /// Its pose on the rig; the identity for the reference camera. In the unit of the file, which
    /// is the metre in Kalibr's.
    pub cam_from_rig: Rigid3,
    /// Time of the reference camera's clock minus that of this camera's clock, in seconds.
    pub time_offset_s: f64,
    /// Its intrinsics, if the file has them.
    pub calibration: Option<CameraCalibration>,
}
