//! The images of a camera in order of time.

use std::collections::BTreeMap;

use tiepoint_geometry::Rigid3;
use tiepoint_rig::{interval_s, timestamp_jitter_s};
use tiepoint_scene::{CameraId, ImageId, Reconstruction};

/// Returns the images of each camera.
pub(crate) fn images_of_cameras(scene: &Reconstruction) -> BTreeMap<CameraId, Vec<ImageId>> {
    let mut images: BTreeMap<CameraId, Vec<ImageId>> = BTreeMap::new();
    for (id, image) in scene.images() {
        images.entry(image.camera).or_default().push(id);
    }
    images
}

/// Returns the times of the images that have one, in order; `None` unless most images have a time,
/// and if they are in whole seconds, as most in EXIF, that do not tell instants.
/// A photo that lost its time is in no frame by time, and leaves the others their frames.
pub(crate) fn images_in_time(
    scene: &Reconstruction,
    images: &[ImageId],
) -> Option<Vec<(f64, ImageId)>> {
    images_in_coarse_time(scene, images)
        .filter(|times| !is_rounded(times.iter().map(|(time_s, _)| *time_s)))
}

/// Whether times were rounded to seconds: all are whole, and several images have one, or they are
/// not as regular as those of an interval timer, whose times are exact but for one offset.
pub(crate) fn is_rounded(times_s: impl Iterator<Item = f64>) -> bool {
    let times_s: Vec<f64> = times_s.collect();
    times_s.iter().all(|time_s| time_s.fract() == 0.0)
        && (interval_s(&times_s) < 1.0 || timestamp_jitter_s(&times_s) > 0.0)
}

/// [`images_in_time`], also of times that were rounded to seconds.
pub(crate) fn images_in_coarse_time(
    scene: &Reconstruction,
    images: &[ImageId],
) -> Option<Vec<(f64, ImageId)>> {
    let mut times: Vec<(f64, ImageId)> =
        images.iter().filter_map(|&id| Some((scene.image(id).time_s?, id))).collect();
    if 2 * times.len() <= images.len() && !images.is_empty() {
        return None;
    }
    times.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    Some(times)
}

/// Returns the registered images of a camera with a time, in order of time; none if the times were
/// rounded to seconds, which tell no motion.
pub(crate) fn posed_in_time(
    model: &Reconstruction,
    camera: CameraId,
) -> Vec<(f64, ImageId, Rigid3)> {
    let images = model.registered().filter(|(_, image, _)| image.camera == camera);
    let mut posed: Vec<_> =
        images.filter_map(|(id, image, pose)| Some((image.time_s?, id, *pose))).collect();
    posed.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    if is_rounded(posed.iter().map(|(time_s, ..)| *time_s)) { Vec::new() } else { posed }
}

/// Quantile of speeds or accelerations that defines the usual one.
const USUAL_QUANTILE: f64 = 0.9;

/// Returns the 90 % quantile of speeds, steps or accelerations.
pub(crate) fn usual(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get((USUAL_QUANTILE * values.len().saturating_sub(1) as f64) as usize).copied()
}
