//! The images of one camera in time.

use std::collections::BTreeMap;

use tiepoint_geometry::Rigid3;
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

/// The images of each camera.
pub(crate) fn images_of_cameras(scene: &Reconstruction) -> BTreeMap<CameraId, Vec<ImageId>> {
    let mut images: BTreeMap<CameraId, Vec<ImageId>> = BTreeMap::new();
    for (id, image) in scene.images() {
        images.entry(image.camera).or_default().push(id);
    }
    images
}

/// Times of the images, in order; `None` unless all have one.
pub(crate) fn images_in_time(
    scene: &Reconstruction,
    images: &[ImageId],
) -> Option<Vec<(f64, ImageId)>> {
    let mut times: Vec<(f64, ImageId)> =
        images.iter().map(|&id| Some((scene.image(id).time_s?, id))).collect::<Option<_>>()?;
    times.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    Some(times)
}

/// Those of a camera's images of which time and pose are known, in order of time.
pub(crate) fn posed_in_time(
    model: &Reconstruction,
    camera: CameraId,
) -> Vec<(f64, ImageId, Rigid3)> {
    let images = model.registered().filter(|(_, image, _)| image.camera == camera);
    let mut posed: Vec<_> =
        images.filter_map(|(id, image, pose)| Some((image.time_s?, id, *pose))).collect();
    posed.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    posed
}

/// The share of the steps at which a camera is no faster than usual.
const USUAL: f64 = 0.9;

/// How fast a camera of these speeds is nine times in ten.
pub(crate) fn usual(mut speeds: Vec<f64>) -> Option<f64> {
    speeds.sort_by(f64::total_cmp);
    speeds.get((USUAL * speeds.len().saturating_sub(1) as f64) as usize).copied()
}
