//! The rendered images of a drive, and the prior calibration of its cameras.

use std::fs;
use std::io::Write;
use std::path::Path;

use tiepoint_pipeline::input::Calibration;
use tiepoint_pipeline::sfm::geometry::CameraModelKind;
use tiepoint_pipeline::store::AtomicFile;
use tiepoint_synth::Drive;

use super::scenery::Scenery;
use crate::drive_folder::{Plan, render};
use crate::{Error, Progress};

/// File that marks a completely rendered drive.
const RENDERED: &str = "truth/rendered";

/// Renders the images of a drive, unless all of them exist.
pub(crate) fn render_once(
    plan: &Plan,
    drive: &Drive,
    progress: &mut dyn Progress,
) -> Result<(), Error> {
    let mark = plan.folder.join(RENDERED);
    if fs::read_to_string(&mark).is_ok_and(|text| text == plan.record()) {
        return Ok(());
    }
    render(plan, drive, progress)?;
    write(&mark, &plan.record())
}

/// The calibration that the mapper starts from: the camera model, and the mean paraxial focal
/// length of the cameras. Intrinsics are refined.
pub(crate) fn calibration(scenery: &Scenery, drive: &Drive) -> Calibration {
    let has_action_lens = scenery.effects.has_action_lens;
    let model = if has_action_lens {
        CameraModelKind::ThinPrismFisheye
    } else {
        CameraModelKind::SimpleRadial
    };
    let focal_px: Vec<f64> = drive.cameras().iter().map(|camera| camera.lens.focal_px()).collect();
    Calibration::Unknown {
        model: Some(model),
        focal_px: Some(focal_px.iter().sum::<f64>() / focal_px.len() as f64),
    }
}

/// Writes a file atomically.
pub(crate) fn write(path: &Path, text: &str) -> Result<(), Error> {
    Ok(AtomicFile::write_with(path, |file| file.write_all(text.as_bytes()))?)
}
