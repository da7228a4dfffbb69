//! Known rigs: COLMAP's `rig_config.json` and Kalibr's camchain.

mod camera_on_rig;
mod colmap;
mod kalibr;
mod rotation;

use std::path::Path;

pub use camera_on_rig::{CameraOnRig, PhotosOfCamera};

use crate::Result;
use crate::calibration::MAX_BYTES;
use crate::text::read_text;

/// Reads COLMAP's `rig_config.json` or Kalibr's camchain; the content decides which it is. Returns
/// at least one rig; the cameras of each begin with the reference camera. No prefix or name is
/// there twice.
///
/// # Errors
///
/// If the file cannot be read, is larger than four megabytes, is neither or not as its format says;
/// if a rig has not exactly one reference camera, or another camera has no pose; if a rotation is
/// none, a number is not finite or intrinsics do not fit their model.
pub fn read(path: &Path) -> Result<Vec<Vec<CameraOnRig>>> {
    let text = read_text(path, MAX_BYTES, "calibration")?;
    if text.trim_start().starts_with(['[', '{']) {
        colmap::rigs(path, &text)
    } else {
        Ok(vec![kalibr::rig(path, &text)?])
    }
}
