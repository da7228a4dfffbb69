//! The camera folder in the names of images.

use tiepoint_sfm::rig_candidates;
use tiepoint_sfm::scene::{Camera, CameraId, Reconstruction};

/// The folder of a camera's images, without a final `/`; `camera N` for images without one.
pub(crate) fn folder_of(model: &Reconstruction, camera: CameraId) -> String {
    let image = model.images().find(|(_, image)| image.camera == camera);
    match image.map_or("", |(_, image)| image.folder()) {
        "" => format!("camera {}", camera.0 + 1),
        folder => folder.to_owned(),
    }
}

/// The camera whose images are in a folder; of several the one that may be on a rig.
pub(crate) fn camera_of_folder<'a>(
    model: &'a Reconstruction,
    folder: &str,
) -> Option<(CameraId, &'a Camera)> {
    let candidates = rig_candidates(model);
    let cameras = || model.cameras().filter(|(id, _)| folder_of(model, *id) == folder);
    cameras().find(|(id, _)| candidates.contains_key(id)).or_else(|| cameras().next())
}

/// The folder of the first image by name, with a final `/`; empty without one.
pub(crate) fn first_folder(model: &Reconstruction) -> String {
    let first = model.images().map(|(_, image)| image.name.as_str()).min().unwrap_or("");
    first.rfind('/').map_or(String::new(), |end| first[..=end].to_owned())
}
