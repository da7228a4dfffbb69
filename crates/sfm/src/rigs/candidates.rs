//! The cameras that may be mounted on a rig.
//!
//! The images of a camera of a rig are a stream of their own ([`tiepoint_scene::Image::stream`]).
//! Further cameras of that stream are other settings of its body (another zoom, held upright,
//! another resolution): their images take turns with those of the first and were never taken at the
//! same instants.

use std::collections::{BTreeMap, BTreeSet};

use tiepoint_scene::{CameraId, ImageId, Reconstruction};

use crate::timeline::images_of_cameras;

/// Returns the images of the cameras that may be on a rig: of each stream the camera with the
/// most images, the first of these. The stream of a camera is that of its first image.
pub fn rig_candidates(scene: &Reconstruction) -> BTreeMap<CameraId, Vec<ImageId>> {
    let mut images = images_of_cameras(scene);
    let mut most: BTreeMap<&str, (usize, CameraId)> = BTreeMap::new();
    for (&camera, images) in &images {
        let Some(first) = images.first() else { continue };
        let best = most.entry(&*scene.image(*first).stream).or_insert((0, camera));
        if images.len() > best.0 {
            *best = (images.len(), camera);
        }
    }
    let candidates: BTreeSet<CameraId> = most.into_values().map(|(_, camera)| camera).collect();
    images.retain(|camera, _| candidates.contains(camera));
    images
}

#[cfg(test)]
mod tests {
    use tiepoint_geometry::{CameraModelKind, Intrinsics};
    use tiepoint_scene::{Camera, Image};

    use super::*;

    #[test]
    fn a_stream_has_one_camera_of_a_rig() {
        let mut scene = Reconstruction::default();
        for names in [&["left/0"][..], &["left/1", "left/2"], &["right/0", "right/2"], &["right/1"]]
        {
            let intrinsics = Intrinsics::centred(CameraModelKind::SimplePinhole, 500.0, 640, 480);
            let camera = Camera { intrinsics, width: 640, height: 480, has_focal_prior: true };
            let camera = scene.add_camera(camera);
            for name in names {
                scene.add_image(Image::new(*name, camera, Vec::new()));
            }
        }
        let found: Vec<u32> = rig_candidates(&scene).keys().map(|camera| camera.0).collect();
        assert_eq!(found, [1, 2]);
        assert!(rig_candidates(&Reconstruction::default()).is_empty());
    }
}
