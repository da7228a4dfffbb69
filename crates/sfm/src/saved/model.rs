//! A model as its difference to the scene that all models of a run begin from.

use std::collections::BTreeSet;
use std::sync::Arc;

use tiepoint_geometry::nalgebra::{Vector2, Vector3};
use tiepoint_geometry::{Intrinsics, Rigid3};
use tiepoint_scene::{CameraId, Frame, Image, ImageId, PointId, Reconstruction, Rig, Track};

use super::codec::{Reader, Saved, Writer};

/// Ids of deleted points stay free: the order of the points, which is that of their ids, decides
/// the order of sums.
impl Saved for Reconstruction {
    fn write(&self, to: &mut Writer) {
        let scene = to.scene;
        self.cameras().for_each(|(_, camera)| camera.intrinsics.write(to));
        self.calibrated.write(to);
        for ((_, image), (_, original)) in self.images().zip(scene.images()) {
            image.cam_from_world().copied().write(to);
            moved_pixels(image, original).write(to);
        }
        self.point_id_bound().write(to);
        for id in (0..self.point_id_bound()).map(PointId::from_index) {
            match self.track(id) {
                Some(track) => {
                    true.write(to);
                    track.write(to);
                }
                None => false.write(to),
            }
        }
        self.rigs.write(to);
        self.frames.write(to);
    }

    fn read(from: &mut Reader) -> Option<Self> {
        let mut model = from.scene.clone();
        for id in (0..model.num_cameras()).map(CameraId::from_index) {
            let intrinsics = Intrinsics::read(from)?;
            let is_known =
                model.calibrated.contains(&id) || model.intrinsics_priors.contains_key(&id);
            let camera = model.camera_mut(id);
            // The mapper selects camera models of unknown lenses alone.
            if is_known && intrinsics.kind() != camera.intrinsics.kind() {
                return None;
            }
            camera.intrinsics = intrinsics;
        }
        model.calibrated = BTreeSet::read(from)?;
        for id in (0..model.num_images()).map(ImageId::from_index) {
            if let Some(pose) = Option::<Rigid3>::read(from)? {
                model.register(id, pose);
            }
            if let Some(pixels) = Option::<Vec<Vector2<f64>>>::read(from)? {
                let is_finite = pixels.iter().flatten().all(|value| value.is_finite());
                if pixels.len() != model.image(id).keypoints.len() || !is_finite {
                    return None;
                }
                model.move_keypoints(id, &pixels);
            }
        }
        for _ in 0..usize::read(from)? {
            match Option::<Track>::read(from)? {
                Some(track) => add(&mut model, track)?,
                None => {
                    let id = model.add_track(Track::new(Vector3::zeros(), Vec::new()));
                    model.delete_track(id);
                }
            }
        }
        model.rigs = Vec::<Rig>::read(from)?;
        model.frames = Vec::<Frame>::read(from)?;
        model.validate().ok()?;
        Some(model)
    }
}

/// The pixels of the keypoints of an image, unless they are those of the scene.
fn moved_pixels(image: &Image, original: &Image) -> Option<Vec<Vector2<f64>>> {
    let bits = |pixel: &Vector2<f64>| [pixel.x.to_bits(), pixel.y.to_bits()];
    let are_same = Arc::ptr_eq(&image.keypoints, &original.keypoints)
        || image
            .keypoints
            .iter()
            .zip(original.keypoints.iter())
            .all(|(one, other)| bits(&one.pixel) == bits(&other.pixel));
    (!are_same).then(|| image.keypoints.iter().map(|keypoint| keypoint.pixel).collect())
}

/// Adds a track if all that it observes is there and free.
fn add(model: &mut Reconstruction, track: Track) -> Option<()> {
    let is_free = |observation: &tiepoint_scene::Observation| {
        let image = model.image(observation.image);
        image.points().get(observation.keypoint as usize) == Some(&None)
    };
    let mut observations = track.observations.clone();
    observations.sort_unstable();
    observations.dedup();
    let is_sound = observations.len() == track.observations.len()
        && observations.len() >= 2
        && observations.iter().all(is_free);
    if is_sound {
        model.add_track(track);
    }
    is_sound.then_some(())
}
