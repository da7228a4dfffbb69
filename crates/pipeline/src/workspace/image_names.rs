//! The streams of cameras, by their names.

use tiepoint_sfm::rigs::rig_candidates;
use tiepoint_sfm::scene::{Camera, CameraId, Reconstruction};

/// The stream of a camera's images; `camera N` for images without one.
pub(crate) fn stream_of(model: &Reconstruction, camera: CameraId) -> String {
    let image = model.images().find(|(_, image)| image.camera == camera);
    match image.map_or("", |(_, image)| &*image.stream) {
        "" => format!("camera {}", camera.0 + 1),
        stream => stream.to_owned(),
    }
}

/// The camera of a stream; of several the one that may be on a rig.
pub(crate) fn camera_of_stream<'a>(
    model: &'a Reconstruction,
    stream: &str,
) -> Option<(CameraId, &'a Camera)> {
    let candidates = rig_candidates(model);
    let cameras = || model.cameras().filter(|(id, _)| stream_of(model, *id) == stream);
    cameras().find(|(id, _)| candidates.contains_key(id)).or_else(|| cameras().next())
}

/// The stream of the first image by name.
pub(crate) fn first_stream(model: &Reconstruction) -> &str {
    let first = model.images().map(|(_, image)| image).min_by_key(|image| &image.name);
    first.map_or("", |image| &*image.stream)
}
